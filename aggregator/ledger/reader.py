"""What a ledger holds: runs, tubers, logs, marks, sums. Every row is verified (`aggregator.ledger.verified`)."""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from aggregator.core.coverage import Coverage, Moment, coverage
from aggregator.core.foreign import ForeignBody
from aggregator.core.sight import CameraSight
from aggregator.ledger.receipt import is_being_written
from aggregator.ledger.rows import body_from, tuber_from
from aggregator.ledger.schema import BATCH, COVERAGE, ENTRY, FOREIGN, OBSERVATION, RUN, SUMMARY, TOTAL, TUBER
from aggregator.ledger.sums import RunSums
from aggregator.ledger.verified import LedgerView, Row, reading
from conveyor.errors import LedgerError, MessageError
from conveyor.messages import Mark, TrackEntry, Tuber

__all__ = ["LedgerView", "reading"]


@dataclass(frozen=True, slots=True)
class RunRow:
    """One run as the ledger knows it; `started_ns` by the clock of the machine that began it."""

    run: str
    line: str
    cameras: tuple[str, ...]
    fingerprint: str
    version: str
    started_ns: int
    finished: bool


def ledger_file(path: Path) -> Path:
    """The ledger meant by a run's folder or by the file itself."""
    return path / "ledger.db" if path.is_dir() else path


def read_run(view: LedgerView, run: str) -> RunRow | None:
    """The run of that id."""
    found = view.row(RUN, "WHERE run = ?", (run,))
    return _run_row(view, found) if found else None


def read_runs(view: LedgerView) -> list[RunRow]:
    """All runs in the order they were begun, whatever the machine's clock said then."""
    return [_run_row(view, found) for found in view.rows(RUN, "ORDER BY rowid")]


def _run_row(view: LedgerView, columns: Row) -> RunRow:
    run, line, cameras, fingerprint, version, started_ns = columns
    finished = view.row(SUMMARY, "WHERE run = ?", (run,)) is not None
    return RunRow(run, line, tuple(json.loads(cameras)), fingerprint, version, started_ns, finished)


def the_run(view: LedgerView, path: Path, run: str | None) -> RunRow:
    """The run named, or the only one there is.

    Raises:
        LedgerError: no such run, or several to choose from.
    """
    runs = read_runs(view)
    chosen = [known for known in runs if run is None or known.run == run]
    if len(chosen) == 1:
        return chosen[0]
    names = ", ".join(known.run for known in runs) or "none"
    if chosen:
        raise LedgerError(f"ledger {path} holds {len(runs)} runs; choose one with --run: {names}")
    raise LedgerError(f"ledger {path} holds no run{f' {run!r}' if run else ''}; known: {names}")


def all_runs(view: LedgerView, path: Path) -> list[RunRow]:
    """The runs of a ledger in the order they were begun: a line that is started again goes on in its ledger.

    Raises:
        LedgerError: it holds none.
    """
    runs = read_runs(view)
    if not runs:
        raise LedgerError(f"ledger {path} holds no run")
    return runs


def runs_in_words(runs: Sequence[str]) -> str:
    """The name of one run, or of several together."""
    return runs[0] if len(runs) == 1 else f"{runs[0]}_to_{runs[-1]}"


def read_tubers(view: LedgerView, run: str, *, since: int = 0, limit: int | None = None) -> Iterator[Tuber]:
    """Committed tubers of `run` with ids above `since`, by id, `limit` of them at most.

    Raises:
        LedgerError: one is damaged, or one of those that the run's sums tell of is not there.
    """
    sums = read_sums(view, run) if view.version >= 2 else None
    whole = sums is not None and sums.count(TUBER) == sums.last_tuber_id  # a repair may have lost some, and said so
    last_id, found = since, 0
    limited = "" if limit is None else f" LIMIT {limit:d}"
    for columns in view.rows(TUBER, f"WHERE run = ? AND tuber_id > ? ORDER BY tuber_id{limited}", (run, since)):
        tuber = tuber_from(columns)
        if whole and tuber.tuber_id != last_id + 1:
            raise _lacks(view, run, last_id + 1)
        last_id, found = tuber.tuber_id, found + 1
        yield tuber
    if sums is not None and last_id < sums.last_tuber_id and (limit is None or found < limit):
        raise _lacks(view, run, last_id + 1)


def _lacks(view: LedgerView, run: str, tuber_id: int) -> LedgerError:
    return LedgerError(
        f"ledger {view.path} lacks the row of table tuber with run '{run}', tuber_id {tuber_id}, which its sums tell "
        f"of; `tuberline ledger repair {view.path}` computes it again from its tracks"
    )


def read_bodies(view: LedgerView, run: str) -> Iterator[ForeignBody]:
    """What of `run` was no tuber, by id; none in a ledger before version 4."""
    return map(body_from, view.rows(FOREIGN, "WHERE run = ? ORDER BY body_id", (run,)))


def read_tubers_near(view: LedgerView, run: str, low_x_m: float, high_x_m: float) -> Iterator[Tuber]:
    """Committed tubers whose place lies between the two, by id."""
    where = "WHERE run = ? AND place_x_m BETWEEN ? AND ? ORDER BY tuber_id"
    return map(tuber_from, view.rows(TUBER, where, (run, low_x_m, high_x_m)))


def read_entry(view: LedgerView, run: str, camera: str, n: int) -> bytes | None:
    """The payload of one entry; None where the ledger does not hold it."""
    found = view.row(ENTRY, "WHERE run = ? AND camera = ? AND n = ?", (run, camera, n))
    return None if found is None else found[5]


def read_entries_after(view: LedgerView, run: str, camera: str, n: int) -> Iterator[Row]:
    """Rows of a camera's log after entry n, in order."""
    return view.rows(ENTRY, "WHERE run = ? AND camera = ? AND n > ? ORDER BY n", (run, camera, n))


def read_observations(view: LedgerView, run: str, *, tuber_id: int) -> Iterator[Row]:
    """Where the tracks of a tuber went, by camera and entry."""
    # Sorted here: asked for this order SQLite walks the key of the whole run, 6 s at a million tubers.
    found = view.rows(OBSERVATION, "WHERE run = ? AND tuber_id = ?", (run, tuber_id))
    return iter(sorted(found, key=lambda seen: (seen[1], seen[2])))


def is_observed(view: LedgerView, run: str, camera: str, n: int) -> bool:
    """The track of entry n of a camera's log has gone somewhere."""
    return view.row(OBSERVATION, "WHERE run = ? AND camera = ? AND n = ?", (run, camera, n)) is not None


def knows_track(view: LedgerView, run: str, track_id: str) -> bool:
    """A track of that id has gone somewhere, as more than the repeat of one."""
    where = "WHERE run = ? AND track_id = ? AND role != 'repeat'"
    return view.row(OBSERVATION, where, (run, track_id)) is not None


def read_coverage(view: LedgerView, run: str, camera: str, *, limit: int, newest: bool) -> list[Row]:
    """The first or the newest rows of a camera's marks, oldest first."""
    order = "DESC" if newest else "ASC"
    where = f"WHERE run = ? AND camera = ? ORDER BY n {order} LIMIT {limit:d}"
    return sorted(view.rows(COVERAGE, where, (run, camera)), key=lambda found: int(found[2]))


def read_marks(view: LedgerView, run: RunRow) -> dict[str, Mark]:
    """The newest mark of each camera that sent one."""
    marks = {}
    for camera in run.cameras:
        for found in read_coverage(view, run.run, camera, limit=1, newest=True):
            mark = read_mark(view, run.run, camera, found[2])
            if mark is not None:
                marks[camera] = mark
    return marks


def read_mark(view: LedgerView, run: str, camera: str, n: int) -> Mark | None:
    """The mark that is entry n of a camera's log; None where that was lost, or is a track."""
    payload = read_entry(view, run, camera, n)
    return None if not payload else decoded(view, payload, f"run '{run}', camera '{camera}', n {n}").mark


def decoded(view: LedgerView, payload: bytes, where: str) -> TrackEntry:
    """An entry's message.

    Raises:
        LedgerError: the bytes are as they were written, but this program cannot read them.
    """
    try:
        return TrackEntry.decode(payload)
    except MessageError as error:
        raise LedgerError(
            f"ledger {view.path}: the row of table entry with {where} holds a message that this version cannot read "
            f"({error}); read it with the version that wrote it"
        ) from error


def read_last_batch(view: LedgerView, run: str) -> Row | None:
    """The newest batch of a run."""
    return view.row(BATCH, "WHERE run = ? ORDER BY seq DESC", (run,))


def read_summary(view: LedgerView, run: str) -> str | None:
    """The summary of a run that ended."""
    found = view.row(SUMMARY, "WHERE run = ?", (run,))
    return None if found is None else str(found[1])


def read_sums(view: LedgerView, run: str) -> RunSums:
    """The sums of a run; added up from its rows in a ledger of version 1.

    Raises:
        LedgerError: they are damaged, or not there.
    """
    if view.version < 2:
        from aggregator.ledger.recount import recount

        return recount(view, run)
    found = view.row(TOTAL, "WHERE run = ?", (run,))
    if found is None:
        raise LedgerError(
            f"ledger {view.path} lacks the sums of run '{run}'; `tuberline ledger repair {view.path}` adds them up"
        )
    return RunSums.from_text(found[2])


def run_being_written(view: LedgerView) -> str | None:
    """The run that a line is writing now: of those that are not stopped the one that was begun last where nothing of it
    is there yet, else that of the newest batch. None where none is.
    """
    if not is_being_written(view.path):
        return None
    batches: dict[str, int] = {}
    for run in read_runs(view):
        if not read_sums(view, run.run).stopped:
            newest = read_last_batch(view, run.run)
            batches[run.run] = -1 if newest is None else newest[0]
    if not batches:
        return None
    begun_last = next(reversed(batches))
    return begun_last if batches[begun_last] < 0 else max(batches, key=batches.__getitem__)


def moment_of(run: RunRow, written: str | None) -> Moment:
    """How who reads a ledger asks what of `run` was seen: it is over, but for the run that is `written` just now: belt
    that its log has not come to yet is not belt that was missed.
    """
    return Moment(over=run.finished or run.run != written)


def sights_of(run: RunRow, sums: RunSums) -> dict[str, CameraSight]:
    """What each camera of a run looked at; one that never sent a mark looked at nothing, which is not no camera."""
    return {camera: sums.sights.get(camera, CameraSight()) for camera in run.cameras}


def coverage_of(run: RunRow, sums: RunSums, moment: Moment | None = None) -> Coverage:
    """What of a run's belt was seen, as its ledger knows it; `moment` as by `moment_of`, else the run is over."""
    return coverage(sights_of(run, sums), seen_by=sums.load.seen_by, moment=moment or Moment(over=True))


def entry_checksum(payload: bytes) -> int:
    """CRC-32 by which entries are compared, each as this version writes it: one of an older version stays the same."""
    with suppress(MessageError):  # one that was set aside is compared as it came
        payload = TrackEntry.decode(payload).encode()
    return zlib.crc32(payload)
