"""Saves what is intact in a damaged ledger into a new file; the damaged one is kept beside it.

A damaged tuber row is computed again where its tracks are intact (fusion is deterministic). A damaged entry leaves an
empty row of kind 'lost', so that the logs stay numbered. What cannot be saved is named, and counted in the new ledger's
last batch: the total is smaller only where this says so.
"""

from __future__ import annotations

import math
import shutil
import sqlite3
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

from aggregator.core.loads import NO_LOAD, LoadBook, LoadEvent, Said
from aggregator.core.merge import Group, PlacedTrack
from aggregator.core.reasons import Role
from aggregator.core.tubers import make_tuber
from aggregator.ledger.faults import DAMAGE, explained
from aggregator.ledger.load_rows import SpanSums, event_from, event_row
from aggregator.ledger.receipt import Receipt, receipt_path
from aggregator.ledger.recount import recounted, recounted_spans
from aggregator.ledger.rows import body_from, tuber_from, tuber_row
from aggregator.ledger.schema import (
    BATCH,
    COVERAGE,
    ENTRY,
    FOREIGN,
    LOAD_EVENT,
    LOAD_TOTAL,
    OBSERVATION,
    OLDEST_VERSION,
    RUN,
    SCHEMA_VERSION,
    SUMMARY,
    TABLES,
    TOTAL,
    TUBER,
    WRITTEN_ONCE,
    Table,
    checksum,
    definition,
    row,
)
from aggregator.ledger.seal import break_seal
from aggregator.ledger.steps import first_step, span_step
from aggregator.ledger.sums import DEFAULT_STEP_G, RunSums
from conveyor.errors import LedgerError, MessageError
from conveyor.messages import TrackEntry

Row = tuple[Any, ...]


@dataclass(slots=True)
class Repaired:
    """What a repair did, in words: `saved` rows by table, what was computed again, what is lost."""

    saved: dict[str, int] = field(default_factory=dict)
    repaired: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    kept_as: Path | None = None


def repair(path: Path) -> Repaired:
    """Replace the ledger at `path` by a new one with everything that is intact in it.

    Raises:
        LedgerError: nothing of it can be read, or the new file cannot be written.
    """
    if not path.is_file():
        raise LedgerError(f"there is no ledger at {path}; give a run's folder or its ledger.db")
    report = Repaired()
    fresh = path.with_name(path.name + ".repaired")
    with Receipt(receipt_path(path)) as receipt, explained(path, "repairing"):
        report.kept_as = _keep(path)
        fresh.unlink(missing_ok=True)
        rows = _intact_rows(path, report)
        if not rows[RUN.name]:
            raise LedgerError(f"no run can be read from {path}: there is nothing to save")
        _mend_tubers(rows, report)
        _mend_logs(rows, report)
        _mend_events(rows, report)
        _drop_orphans(rows, report)
        seq = _number_batches(rows)
        _write(fresh, rows)
        break_seal(receipt_path(path))
        _swap(path, fresh)
        receipt.write(seq)
        receipt.write(seq - 1)
    report.saved = {table.name: len(rows[table.name]) for table in WRITTEN_ONCE}
    return report


def _intact_rows(path: Path, report: Repaired) -> dict[str, list[Row]]:
    """Rows of every table whose checksum is right, read one by one past the damage."""
    db = sqlite3.connect(path, isolation_level=None)
    try:
        return {table.name: _read_table(db, table, report) for table in TABLES}
    finally:
        db.close()


def _read_table(db: sqlite3.Connection, table: Table, report: Repaired) -> list[Row]:
    good: dict[tuple[Any, ...], Row] = {}
    keys = [table.names.index(key) for key in table.key.split(", ")]
    bad = 0
    for found in _both_ways(db, table, report):
        if checksum(found[:-1]) == found[-1]:
            good[tuple(found[at] for at in keys)] = found
        else:
            bad += 1
    if bad:
        report.repaired.append(f"{table.name}: rows with a wrong checksum were left out")
    return [good[key] for key in sorted(good)]


def _both_ways(db: sqlite3.Connection, table: Table, report: Repaired) -> list[Row]:
    """Rows from the front until the damage, and from the back until the damage; columns as they were made."""
    rows: list[Row] = []
    (version,) = db.execute("PRAGMA user_version").fetchone()
    version = version if OLDEST_VERSION <= version <= SCHEMA_VERSION else SCHEMA_VERSION
    if table.since > version:
        return rows
    for order in ("ASC", "DESC"):
        cursor = db.cursor()
        try:
            rows.extend(cursor.execute(f"{table.select(version)} ORDER BY rowid {order}"))
            break
        except DAMAGE as error:
            report.repaired.append(f"{table.name}: reading ({order}) stopped at damage: {error}")
    return rows


def _mend_tubers(rows: dict[str, list[Row]], report: Repaired) -> None:
    """Compute tubers again whose row is gone but whose tracks are there."""
    entries = {entry[:3]: entry[5] for entry in rows[ENTRY.name] if entry[3] == "track"}
    have = {(tuber[0], tuber[1]) for tuber in rows[TUBER.name]}
    groups: dict[tuple[str, int], list[Row]] = {}
    for seen in rows[OBSERVATION.name]:
        if seen[4] == Role.COUNTED:
            groups.setdefault((seen[0], seen[5]), []).append(seen)
    for key in sorted(set(groups) - have):
        group = _group(groups[key], entries)
        if group is None:
            report.lost.append(f"tuber {key[1]} of run {key[0]}: its row and some of its tracks are damaged")
        else:
            rows[TUBER.name].append(tuber_row(make_tuber(group, run=key[0], tuber_id=key[1])))
            report.repaired.append(f"tuber {key[1]} of run {key[0]} was computed again from its tracks")
    rows[TUBER.name].sort(key=lambda tuber: (tuber[0], tuber[1]))


def _group(seen: Sequence[Row], entries: dict[Row, bytes]) -> Group | None:
    members = []
    for run, camera, n, _track, _role, _tuber, x_m, y_m, *_ in seen:
        payload = entries.get((run, camera, n))
        try:
            track = TrackEntry.decode(payload).track if payload is not None else None
        except MessageError:
            track = None
        if track is None:
            return None
        members.append(PlacedTrack(camera, n, track, x_m, y_m))
    return Group(members)


def _mend_logs(rows: dict[str, list[Row]], report: Repaired) -> None:
    """Fill the holes of each log with rows of kind 'lost', so that it stays numbered without a gap."""
    logs: dict[tuple[str, str], set[int]] = {}
    for run, camera, n, *_ in [*rows[ENTRY.name], *rows[OBSERVATION.name], *rows[COVERAGE.name]]:
        logs.setdefault((run, camera), set()).add(n)
    have = {entry[:3] for entry in rows[ENTRY.name]}
    for (run, camera), numbers in sorted(logs.items()):
        holes = [n for n in range(1, max(numbers) + 1) if (run, camera, n) not in have]
        rows[ENTRY.name] += [row((run, camera, n, "lost", math.inf, b"")) for n in holes]
        if holes:
            report.lost.append(f"{len(holes)} entries of {camera} in run {run}: {holes[:10]}")
    rows[ENTRY.name].sort(key=lambda entry: entry[:3])


def _mend_events(rows: dict[str, list[Row]], report: Repaired) -> None:
    """Fill the holes among the events of loads, so that they stay numbered without a gap."""
    have = {event[0] for event in rows[LOAD_EVENT.name]}
    holes = [n for n in range(1, max(have, default=0) + 1) if n not in have]
    run = rows[RUN.name][0][0]
    for n in holes:
        event = LoadEvent(n, run, f"lost-{n}", Said.LOST, NO_LOAD, None, 0, "", {})
        rows[LOAD_EVENT.name].append(event_row(event))
        report.lost.append(f"event {n} of loads: what it said is damaged, belt that it began goes to what was before")
    rows[LOAD_EVENT.name].sort(key=lambda event: int(event[0]))


def _drop_orphans(rows: dict[str, list[Row]], report: Repaired) -> None:
    """Leave out observations of tubers that are lost, and tubers that no observation is left of."""
    tubers = {(tuber[0], tuber[1]) for tuber in rows[TUBER.name]}
    kept = [seen for seen in rows[OBSERVATION.name] if seen[5] is None or (seen[0], seen[5]) in tubers]
    counted = {(seen[0], seen[5]) for seen in kept if seen[4] == Role.COUNTED}
    for run, tuber_id in sorted(tubers - counted):
        report.repaired.append(f"tuber {tuber_id} of run {run}: its observation is damaged, the tuber itself is kept")
    rows[OBSERVATION.name] = kept
    rows[SUMMARY.name] = [summary for summary in rows[SUMMARY.name] if not report.lost]


def _number_batches(rows: dict[str, list[Row]]) -> int:
    """One batch per run, with what is there now; the line stays where it was."""
    last_watermark = {run: watermark_x_m for _seq, run, watermark_x_m, *_ in rows[BATCH.name]}
    rows[BATCH.name] = []
    for seq, (run, *_) in enumerate(rows[RUN.name], start=1):
        counts = [sum(1 for found in rows[name] if found[0] == run) for name in ("entry", "tuber", "observation")]
        watermark_x_m = last_watermark.get(run, min((t[3] for t in rows[TUBER.name] if t[0] == run), default=math.inf))
        rows[BATCH.name].append(row((seq, run, watermark_x_m, *counts)))
    return len(rows[BATCH.name])


def _write(path: Path, rows: dict[str, list[Row]]) -> None:
    db = sqlite3.connect(path, isolation_level=None)
    try:
        db.execute("PRAGMA synchronous = FULL")
        db.execute("BEGIN IMMEDIATE")
        for statement in definition():
            db.execute(statement)
        for table in WRITTEN_ONCE:
            db.executemany(table.insert, rows[table.name])
        for (run, *_), sums in zip(rows[RUN.name], _sums(rows), strict=True):
            first_step(db, run, sums)
            for n, span in _spans(rows, run, sums).items():
                span_step(db, run, n, span)
        db.execute("COMMIT")
    finally:
        db.close()


def _sums(rows: dict[str, list[Row]]) -> list[RunSums]:
    """The sums of each run, added up again; what its cameras looked at is as intact old sums have it."""
    old = {run: RunSums.from_text(payload) for run, _step, payload, _crc in rows[TOTAL.name]}
    found = []
    for run, *_ in rows[RUN.name]:
        step_g = old[run].load.histogram_step_g if run in old else DEFAULT_STEP_G
        own = [(table, [r[:-1] for r in rows[table.name] if r[_run_at(table)] == run]) for table in WRITTEN_ONCE]
        sums = recounted(own, histogram_step_g=step_g)
        if run in old:
            sums.sights, sums.head_start_m = old[run].sights, old[run].head_start_m
        found.append(sums)
    return found


def _spans(rows: dict[str, list[Row]], run: str, sums: RunSums) -> dict[int, SpanSums]:
    """The sums of each stretch of a run's belt, added up again; what was seen of it as intact old sums have it."""
    book = LoadBook.of(event_from(event[:-1]) for event in rows[LOAD_EVENT.name])
    tubers = (tuber_from(tuber[:-1]) for tuber in rows[TUBER.name] if tuber[0] == run)
    bodies = (body_from(body[:-1]) for body in rows[FOREIGN.name] if body[0] == run)
    counted = recounted_spans(
        chain(tubers, bodies), book.spans.get(run, []), histogram_step_g=sums.load.histogram_step_g
    )
    old = {key[1]: SpanSums.from_text(key[3]).seen for key in rows[LOAD_TOTAL.name] if key[0] == run}
    return {n: SpanSums(load, old.get(n)) for n, load in counted.items()}


def _run_at(table: Table) -> int:
    return table.names.index("run")


def _keep(path: Path) -> Path:
    """Copy the ledger and its log under a new name before anything is touched."""
    n = 1
    while (kept := path.with_name(f"{path.name}.damaged-{n}")).exists():
        n += 1
    try:
        for suffix in ("", "-wal"):
            source = path.with_name(path.name + suffix)
            if source.exists():
                shutil.copy2(source, kept.with_name(kept.name + suffix))
    except OSError as error:
        raise LedgerError(f"{path} cannot be copied to {kept}: {error.strerror or error}; free some space") from error
    return kept


def _swap(path: Path, fresh: Path) -> None:
    """Put `fresh` in the place of the ledger at `path`, whose log must not be applied to it."""
    try:
        for suffix in ("-wal", "-shm"):
            path.with_name(path.name + suffix).unlink(missing_ok=True)
        fresh.replace(path)
    except OSError as error:
        raise LedgerError(f"{fresh} cannot take the place of {path}: {error.strerror}") from error
