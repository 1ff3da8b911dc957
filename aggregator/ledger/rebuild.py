"""What damage took from a ledger, made again from what its other rows say of it.

A tuber follows from its tracks, where a track went from the tuber that names it, a camera's progress from the marks in
its log. What is made so is as it was written, or said not to be.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from aggregator.core.loads import NO_LOAD, LoadEvent, Said
from aggregator.core.machine import Observation
from aggregator.core.merge import Group, PlacedTrack
from aggregator.core.reasons import Role
from aggregator.core.sight import CameraSight
from aggregator.core.tubers import make_tuber
from aggregator.ledger.likeness import Row
from aggregator.ledger.load_rows import event_row
from aggregator.ledger.rows import body_from, coverage_row, observation_row, tuber_from, tuber_row
from aggregator.ledger.schema import (
    BATCH,
    COVERAGE,
    ENTRY,
    FOREIGN,
    LOAD_EVENT,
    OBSERVATION,
    RUN,
    TABLES,
    TOTAL,
    TUBER,
    WRITTEN_ONCE,
    Table,
    row,
)
from aggregator.ledger.sums import RunSums
from conveyor.errors import MessageError
from conveyor.messages import TrackEntry

Rows = dict[str, list[Row]]
"""Rows of each table, by its name."""
SHOWN = 10
UNKNOWN_VERSION = "unknown"


@dataclass(slots=True)
class Repaired:
    """What a repair did, in words: `saved` rows by table, what was put back or made again, what is lost.

    `less`: runs that hold less than they did: what was told of them when they ended is true no more. `lossy`: these,
    and runs of which something else is lost: their sums say so from now on.
    """

    saved: dict[str, int] = field(default_factory=dict)
    repaired: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    less: set[str] = field(default_factory=set)
    lossy: set[str] = field(default_factory=set)
    kept_as: Path | None = None

    def lacks(self, run: str, text: str) -> None:
        """Something of a run is lost that its totals were made of."""
        self.lost_of(run, text)
        self.less.add(run)

    def lost_of(self, run: str, text: str) -> None:
        """Something of a run is lost, be it none of its rows."""
        self.lost.append(text)
        self.lossy.add(run)


@dataclass(frozen=True, slots=True)
class Expected:
    """How many rows a run had, by table, as far as is known; `sums` are those carried along, where they are intact."""

    counts: Mapping[str, int]
    sums: RunSums | None = None


def expected(rows: Rows) -> dict[str, Expected]:
    """By its sums, else by its newest batch, what each run had; runs that neither is left of are left out."""
    found = {
        run: Expected(dict(zip((ENTRY.name, TUBER.name, OBSERVATION.name), counts, strict=True)))
        for _seq, run, _watermark_x_m, *counts, _crc in rows[BATCH.name]
    }
    for run, _step, payload, _crc in rows[TOTAL.name]:
        sums = RunSums.from_text(payload)
        found[run] = Expected({table.name: sums.count(table) for table in WRITTEN_ONCE}, sums)
    return found


def by_run(rows: Rows) -> dict[str, Rows]:
    """The rows of each run, by table; runs in the order they were begun, as far as their clocks tell it."""
    begun = sorted(rows[RUN.name], key=lambda one: (one[RUN.names.index("started_ns")], one[0]))
    found: dict[str, Rows] = {run: {table.name: [] for table in TABLES} for run, *_ in begun}
    for table in TABLES:
        at = table.names.index("run")
        for one in rows[table.name]:
            if one[at] in found:  # sums may be left of a run of which nothing else is
                found[one[at]][table.name].append(one)
    return found


def runs(rows: Rows, had: Mapping[str, Expected], report: Repaired) -> None:
    """Runs whose own row is gone, by what is left of them."""
    known = {found[0] for found in rows[RUN.name]}
    named = {found[table.names.index("run")] for table in (*WRITTEN_ONCE, TOTAL) for found in rows[table.name]}
    lines = [found[1] for found in rows[RUN.name]]
    for run in sorted(named - known):
        sums = had[run].sums if run in had else None
        logged = [*rows[ENTRY.name], *rows[OBSERVATION.name], *rows[COVERAGE.name]]
        cameras = {found[1] for found in logged if found[0] == run} | set(sums.sights if sums else ())
        times = [found[3] for found in rows[COVERAGE.name] if found[0] == run]
        times += [found[2] for found in rows[TUBER.name] if found[0] == run]
        started_ns = min((ns for ns in times if ns), default=0)
        line = lines[0] if lines else ""
        rows[RUN.name].append(row((run, line, json.dumps(sorted(cameras)), "", UNKNOWN_VERSION, started_ns)))
        report.lost_of(
            run,
            f"the row of run {run} itself: it began when its first camera says so, with the cameras "
            f"{', '.join(sorted(cameras)) or 'none'} that it knows; which recording it was of is not known any more",
        )
    rows[RUN.name].sort(key=lambda found: str(found[0]))


def marks(rows: Rows, report: Repaired) -> None:
    """Rows of `coverage` from the marks in the logs."""
    have = {found[:3] for found in rows[COVERAGE.name]}
    again = []
    for found in rows[ENTRY.name]:
        if found[3] == "mark" and found[:3] not in have:
            entry = _decoded(found)
            if entry is not None and entry.mark is not None:
                again.append(coverage_row(found[0], found[1], found[2], entry.mark))
    if again:
        report.repaired.append(f"{len(again)} rows of coverage were made again from the marks in the logs")
        rows[COVERAGE.name] = sorted([*rows[COVERAGE.name], *again], key=lambda found: found[:3])


def observations(rows: Rows, report: Repaired) -> None:
    """Where tracks went whose row says so no more: to the tuber, or to the foreign body, that names them.

    Without it a run that goes on would count such a track once more.
    """
    observed = {found[:3] for found in rows[OBSERVATION.name]}
    known = {(found[0], found[3]) for found in rows[OBSERVATION.name] if found[4] != Role.REPEAT}
    named = _names(rows)
    again = []
    for found in rows[ENTRY.name]:
        if found[3] != "track" or found[:3] in observed or (entry := _decoded(found)) is None:
            continue
        track = entry.track
        if track is None or (found[0], track.track_id) in known or (found[0], track.track_id) not in named:
            continue
        known.add((found[0], track.track_id))
        tuber_id, place = named[found[0], track.track_id]
        x_m, y_m = place or (track.place_x_m, track.y_m)
        role = Role.FOREIGN if tuber_id is None else Role.COUNTED
        seen = Observation(
            found[1], found[2], track.track_id, role, tuber_id, x_m, y_m, track.first_seq, track.last_seq
        )
        again.append(observation_row(found[0], seen))
    if again:
        report.repaired.append(f"{len(again)} rows of observation were made again from tubers and logs")
        rows[OBSERVATION.name] = sorted([*rows[OBSERVATION.name], *again], key=lambda found: found[:3])


def _names(rows: Rows) -> dict[tuple[str, str], tuple[int | None, tuple[float, float] | None]]:
    """(run, track id) to the tuber that it is of (None: a foreign body), and its place where it is the only one."""
    named: dict[tuple[str, str], tuple[int | None, tuple[float, float] | None]] = {}
    for found in rows[TUBER.name]:
        tuber = tuber_from(found[:-1])
        place = (tuber.place_x_m, tuber.place_y_m) if len(tuber.tracks) == 1 else None
        named |= {(tuber.run, track): (tuber.tuber_id, place) for track in tuber.tracks}
    for found in rows[FOREIGN.name]:
        body = body_from(found[:-1])
        place = (body.place_x_m, body.place_y_m) if len(body.tracks) == 1 else None
        named |= {(body.run, track): (None, place) for track in body.tracks}
    return named


def tubers(rows: Rows, report: Repaired) -> None:
    """Tubers whose row is gone, from those of their tracks that are there. Observations of tubers that cannot be made
    again are left out: a run that goes on counts what is left of their tracks."""
    entries = {found[:3]: found for found in rows[ENTRY.name] if found[3] == "track"}
    have = {found[:2] for found in rows[TUBER.name]}
    groups: dict[tuple[str, int], list[Row]] = {}
    for seen in rows[OBSERVATION.name]:
        if seen[4] == Role.COUNTED and (seen[0], seen[5]) not in have:
            groups.setdefault((seen[0], seen[5]), []).append(seen)
    for (run, tuber_id), seen_as in sorted(groups.items()):
        members = [member for seen in seen_as if (member := _member(seen, entries.get(seen[:3]))) is not None]
        if members:
            rows[TUBER.name].append(tuber_row(make_tuber(Group(members), run=run, tuber_id=tuber_id)))
            have.add((run, tuber_id))
            of = "its tracks" if len(members) == len(seen_as) else f"{len(members)} of its {len(seen_as)} tracks"
            report.repaired.append(f"tuber {tuber_id} of run {run} was computed again from {of}")
    rows[TUBER.name].sort(key=lambda found: found[:2])
    rows[OBSERVATION.name] = [seen for seen in rows[OBSERVATION.name] if seen[5] is None or (seen[0], seen[5]) in have]


def _member(seen: Row, entry: Row | None) -> PlacedTrack | None:
    told = None if entry is None else _decoded(entry)
    if entry is None or told is None or told.track is None:
        return None
    return PlacedTrack(seen[1], seen[2], told.track, seen[6], seen[7], late=seen[6] >= entry[4])


def logs(rows: Rows, had: Mapping[str, Expected], report: Repaired) -> None:
    """Fill the holes of each log with rows of kind 'lost', so that it stays numbered without a gap."""
    have: dict[tuple[str, str], set[int]] = {}
    last: dict[tuple[str, str], int] = {}
    for run, camera, n, *_ in rows[ENTRY.name]:
        have.setdefault((run, camera), set()).add(n)
    for run, camera, n, *_ in (*rows[ENTRY.name], *rows[OBSERVATION.name], *rows[COVERAGE.name]):
        last[run, camera] = max(last.get((run, camera), 0), n)
    for run, of in had.items():
        for camera, n in (of.sums.settled if of.sums else {}).items():
            last[run, camera] = max(last.get((run, camera), 0), n)
        own = [key for key in last if key[0] == run]
        missing = of.counts[ENTRY.name] - sum(last[key] for key in own)
        if missing > 0 and len(own) == 1:
            last[own[0]] += missing
        elif missing > 0:
            report.lacks(run, f"{missing} of the entries of run {run}, the newest of the logs of some of its cameras")
    for (run, camera), newest in sorted(last.items()):
        holes = [n for n in range(1, newest + 1) if n not in have.get((run, camera), set())]
        rows[ENTRY.name] += [row((run, camera, n, "lost", math.inf, b"")) for n in holes]
        if holes:
            report.lacks(run, f"{len(holes)} of the entries of {camera} in run {run}: {listed(holes)}")
    rows[ENTRY.name].sort(key=lambda entry: entry[:3])


def events(rows: Rows, had: Mapping[str, Expected], report: Repaired) -> None:
    """Fill the holes among the events of loads, so that they stay numbered without a gap."""
    have = {found[0]: found[1] for found in rows[LOAD_EVENT.name]}
    of_runs = {run: of.counts.get(LOAD_EVENT.name, 0) for run, of in had.items()}
    lacking = [
        run for run in sorted(of_runs) for _ in range(of_runs[run] - sum(run == other for other in have.values()))
    ]
    holes = [n for n in range(1, max(max(have, default=0), sum(of_runs.values())) + 1) if n not in have]
    for n in holes:
        run = lacking.pop(0) if lacking else rows[RUN.name][0][0]
        event = LoadEvent(n, run, f"lost-{n}", Said.LOST, NO_LOAD, None, 0, "", {})
        rows[LOAD_EVENT.name].append(event_row(event))
        report.lacks(run, f"event {n} of loads: what it said is damaged, belt that it began goes to what was before")
    rows[LOAD_EVENT.name].sort(key=lambda event: int(event[0]))


def sights(own: Rows) -> dict[str, CameraSight]:
    """What the cameras of a run looked at, by the marks in their logs alone. `own`: its rows."""
    found: dict[str, CameraSight] = {}
    for entry in own[ENTRY.name]:
        told = _decoded(entry) if entry[3] == "mark" else None
        if told is not None and told.mark is not None:
            found.setdefault(entry[1], CameraSight()).marked(told.mark)
    return found


def listed(numbers: Sequence[int]) -> str:
    """The first of them, in words."""
    return ", ".join(map(str, numbers[:SHOWN])) + (" and more" if len(numbers) > SHOWN else "")


def account(of_runs: Mapping[str, Rows], had: Mapping[str, Expected], version: int, report: Repaired) -> None:
    """Hold what each run has now against what it had: what is less is lost, and named as far as it can be.

    Entries and events of loads are told by `logs` and `events`, which fill their places.

    Args:
        of_runs: the rows of each run.
        version: of the ledger's schema; the first one carried no sums.
    """
    for run, own in of_runs.items():
        of = had.get(run)
        if of is None:
            report.lacks(run, f"what run {run} came to: its sums and batches are damaged, more of it may be missing")
            continue
        if of.sums is None and version > 1:
            report.lost_of(
                run,
                f"the sums of run {run}, with what its cameras published: its coverage is told by their marks alone, "
                "and may be too high",
            )
        _tubers_missing(own, run, of, report)
        for table, what in (
            (OBSERVATION, "rows of observation, which say where tracks went,"),
            (COVERAGE, "marks"),
            (FOREIGN, "foreign bodies"),
        ):
            missing = of.counts.get(table.name, 0) - len(own[table.name])
            if missing > 0:
                report.lacks(run, f"{missing} of the {what} of run {run}")
        for table in (TUBER, OBSERVATION, COVERAGE):
            if of.sums is not None and _made_otherwise(own, table, of.sums):
                report.repaired.append(f"rows of {table.name} of run {run} are not to the bit those that were written")


def _tubers_missing(own: Rows, run: str, of: Expected, report: Repaired) -> None:
    ids = {found[1] for found in own[TUBER.name]}
    missing = of.counts[TUBER.name] - len(ids)
    if missing > 0:
        last = max([*ids, of.sums.last_tuber_id if of.sums else of.counts[TUBER.name]])
        gone = [n for n in range(1, last + 1) if n not in ids]
        report.lacks(run, f"{missing} of the tubers of run {run}, with their weight: {listed(gone)}")


def _made_otherwise(own: Rows, table: Table, sums: RunSums) -> bool:
    """As many rows as there were, but other ones."""
    now = RunSums(sums.load)
    now.add_rows(table, own[table.name])
    (count, crcs), (said, said_crcs) = now.rows[table.name], sums.rows[table.name]
    return count == said and crcs != said_crcs


def _decoded(entry: Row) -> TrackEntry | None:
    try:
        return TrackEntry.decode(entry[5])
    except MessageError:
        return None
