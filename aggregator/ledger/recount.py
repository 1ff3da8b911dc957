"""The sums of a run added up from its rows, each verified: for an audit, a repair, and ledgers of version 1."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from aggregator.core.foreign import ForeignBody
from aggregator.core.load_sums import LoadSums
from aggregator.core.loads import Span, span_of
from aggregator.core.reasons import Role
from aggregator.core.sight import CameraSight
from aggregator.ledger.rows import body_from, tuber_from
from aggregator.ledger.schema import COVERAGE, ENTRY, FOREIGN, OBSERVATION, TUBER, WRITTEN_ONCE, Table, row
from aggregator.ledger.sums import DEFAULT_STEP_G, RunSums
from aggregator.ledger.verified import LedgerView, Row
from conveyor.messages import Mark, Tuber

ORDER = {
    FOREIGN.name: "body_id",
    TUBER.name: "tuber_id",
    ENTRY.name: "camera, n",
    OBSERVATION.name: "camera, n",
    COVERAGE.name: "camera, n",
}


def recount(view: LedgerView, run: str, *, histogram_step_g: float = DEFAULT_STEP_G) -> RunSums:
    """What the rows of `run` come to. What cameras said that they published is not in them, and not in the sights.

    Raises:
        LedgerError: a row is damaged.
    """

    def rows(table: Table) -> Iterator[Row]:
        order = f" ORDER BY {ORDER[table.name]}" if table.name in ORDER else ""
        return view.rows(table, f"WHERE run = ?{order}", (run,))

    return recounted(((table, rows(table)) for table in WRITTEN_ONCE), histogram_step_g=histogram_step_g)


def recounted(tables: Iterable[tuple[Table, Iterable[Row]]], *, histogram_step_g: float = DEFAULT_STEP_G) -> RunSums:
    """The same of rows (without checksum) of one run by table, tables in the order of `WRITTEN_ONCE`, each in that
    of its key."""
    sums = RunSums(LoadSums(histogram_step_g))
    waiting: dict[str, set[int]] = {}
    groups: set[int] = set()
    for table, rows in tables:
        for found in rows:
            sums.add_rows(table, [row(found)])
            if table is ENTRY and found[3] == "track":
                sums.add_track(found[1])
                waiting.setdefault(found[1], set()).add(found[2])
            elif table is ENTRY and found[3] == "refused":
                sums.add_set_aside(found[1])
            elif table is TUBER:
                sums.add_tuber(tuber_from(found))
            elif table is FOREIGN:
                sums.add_body(body_from(found))
            elif table is OBSERVATION:
                sums.add_observation(found[1], found[4])
                waiting.get(found[1], set()).discard(found[2])
                if found[4] == Role.COUNTED:
                    groups.add(found[5])
            elif table is COVERAGE:
                sums.sights.setdefault(found[1], CameraSight()).marked(mark_from(found))
            if table is ENTRY:
                sums.settled[found[1]] = max(sums.settled.get(found[1], 0), found[2])
    sums.counted = len(groups)
    for camera, numbers in waiting.items():
        if numbers:
            sums.settled[camera] = min(numbers) - 1
    return sums


def recounted_spans(
    tubers: Iterable[Tuber | ForeignBody], spans: Sequence[Span], *, histogram_step_g: float
) -> dict[int, LoadSums]:
    """What the tubers of a run come to in each of its stretches; empty where it has none."""
    found = {span.n: LoadSums(histogram_step_g) for span in spans}
    for tuber in tubers if found else ():
        found[span_of(spans, tuber.place_x_m).n].add(tuber)
    return found


def mark_from(columns: Row) -> Mark:
    """What a row of table `coverage` says; the balance sheets are in its entry alone."""
    captured_ns, travel_m, estimated, complete_x_m, final, looked_at_m, travelled_m = columns[3:10]
    return Mark(
        captured_ns=captured_ns,
        travel_m=travel_m,
        travel_estimated=bool(estimated),
        complete_ns=captured_ns,
        complete_place_x_m=complete_x_m,
        final=bool(final),
        looked_at_m=looked_at_m,
        travelled_m=travelled_m,
        frames={},
        views={},
        tracks={},
    )
