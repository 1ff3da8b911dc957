"""Reads a ledger: runs, tubers, marks, and the state of a run that is to be gone on with."""

from __future__ import annotations

import json
import math
import sqlite3
import zlib
from array import array
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from aggregator.core.camera_log import CameraLog
from aggregator.core.machine import PendingTrack, Restored
from aggregator.ledger.faults import explained
from aggregator.ledger.rows import tuber_from
from aggregator.ledger.schema import APPLICATION_ID, SCHEMA_VERSION, TUBER
from conveyor.errors import LedgerError
from conveyor.messages import Mark, TrackEntry, Tuber


@dataclass(frozen=True, slots=True)
class RunRow:
    """One run as the ledger knows it."""

    run: str
    line: str
    cameras: tuple[str, ...]
    fingerprint: str
    version: str
    finished: bool


@contextmanager
def reading(path: Path) -> Iterator[sqlite3.Connection]:
    """A read-only connection to the ledger at `path`, also while it is being written.

    Raises:
        LedgerError: no ledger, of another version, or unreadable.
    """
    if not path.is_file():
        raise LedgerError(f"there is no ledger at {path}; give a run's folder or its ledger.db")
    immutable = "" if path.with_name(path.name + "-wal").exists() else "&immutable=1"
    with explained(path, "reading"):
        db = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro{immutable}", uri=True, isolation_level=None)
        try:
            check_version(db, path)
            yield db
        finally:
            db.close()


def check_version(db: sqlite3.Connection, path: Path) -> None:
    """Raise LedgerError unless the file is a ledger of this version."""
    (application,) = db.execute("PRAGMA application_id").fetchone()
    (version,) = db.execute("PRAGMA user_version").fetchone()
    if application != APPLICATION_ID:
        raise LedgerError(f"{path} is an SQLite file, but no ledger of Tuberline (application id {application:#x})")
    if version != SCHEMA_VERSION:
        raise LedgerError(
            f"ledger {path} has schema version {version}, this program knows version {SCHEMA_VERSION}: "
            "use the Tuberline that wrote it, or start a new ledger"
        )


def ledger_file(path: Path) -> Path:
    """The ledger meant by a run's folder or by the file itself."""
    return path / "ledger.db" if path.is_dir() else path


_RUN = (
    "SELECT run, line, cameras, fingerprint, version, EXISTS (SELECT 1 FROM summary WHERE summary.run = run.run) "
    "FROM run"
)


def read_run(db: sqlite3.Connection, run: str) -> RunRow | None:
    """The run of that id."""
    found = db.execute(f"{_RUN} WHERE run = ?", (run,)).fetchone()
    return _run_row(found) if found else None


def read_runs(db: sqlite3.Connection) -> list[RunRow]:
    """All runs in the order they were begun."""
    return [_run_row(found) for found in db.execute(f"{_RUN} ORDER BY started_ns, run")]


def _run_row(columns: tuple[Any, ...]) -> RunRow:
    run, line, cameras, fingerprint, version, finished = columns
    return RunRow(run, line, tuple(json.loads(cameras)), fingerprint, version, bool(finished))


def the_run(db: sqlite3.Connection, path: Path, run: str | None) -> RunRow:
    """The run named, or the only one there is.

    Raises:
        LedgerError: no such run, or several to choose from.
    """
    runs = read_runs(db)
    chosen = [known for known in runs if run is None or known.run == run]
    if len(chosen) == 1:
        return chosen[0]
    names = ", ".join(known.run for known in runs) or "none"
    if chosen:
        raise LedgerError(f"ledger {path} holds {len(runs)} runs; choose one with --run: {names}")
    raise LedgerError(f"ledger {path} holds no run{f' {run!r}' if run else ''}; known: {names}")


def read_tubers(db: sqlite3.Connection, run: str) -> Iterator[Tuber]:
    """All committed tubers of `run`, by id."""
    for *columns, _crc in db.execute(f"{TUBER.select} WHERE run = ? ORDER BY tuber_id", (run,)):
        yield tuber_from(columns)


def read_marks(db: sqlite3.Connection, run: str) -> dict[str, Mark]:
    """The newest mark of each camera that sent one."""
    found = db.execute(
        "SELECT camera, payload, max(n) FROM entry WHERE run = ? AND kind = 'mark' GROUP BY camera ORDER BY camera",
        (run,),
    )
    marks = {camera: TrackEntry.decode(payload).mark for camera, payload, _ in found}
    return {camera: mark for camera, mark in marks.items() if mark is not None}


def restore(db: sqlite3.Connection, run: str) -> Restored:
    """The state of `run`: logs, marks, tracks not yet in a tuber, and the line up to which places are committed."""
    (tubers,) = db.execute("SELECT coalesce(max(tuber_id), 0) FROM tuber WHERE run = ?", (run,)).fetchone()
    line = db.execute("SELECT line_x_m FROM batch WHERE run = ? ORDER BY seq DESC LIMIT 1", (run,)).fetchone()
    return Restored(
        logs=_logs(db, run),
        marks=_marks(db, run),
        pending=_pending(db, run),
        tubers=tubers,
        line_x_m=line[0] if line else math.inf,
    )


def _logs(db: sqlite3.Connection, run: str) -> dict[str, CameraLog]:
    logs: dict[str, CameraLog] = {}
    for camera, payload in db.execute("SELECT camera, payload FROM entry WHERE run = ? ORDER BY camera, n", (run,)):
        logs.setdefault(camera, CameraLog(array("I"))).checksums.append(zlib.crc32(payload))
    return logs


def _marks(db: sqlite3.Connection, run: str) -> dict[str, list[Mark]]:
    """Every mark where travel is estimated (its samples are needed), else the newest of each camera."""
    marks: dict[str, list[Mark]] = {}
    found = db.execute(
        "SELECT camera, payload FROM entry JOIN coverage USING (run, camera, n) WHERE run = ? AND (travel_estimated OR "
        "n = (SELECT max(n) FROM coverage AS newest WHERE newest.run = entry.run AND newest.camera = entry.camera)) "
        "ORDER BY camera, n",
        (run,),
    )
    for camera, payload in found:
        mark = TrackEntry.decode(payload).mark
        if mark is not None:
            marks.setdefault(camera, []).append(mark)
    return marks


def _pending(db: sqlite3.Connection, run: str) -> list[PendingTrack]:
    found = db.execute(
        "SELECT camera, n, late_from_x_m, payload FROM entry WHERE run = ? AND kind = 'track' AND NOT EXISTS (SELECT 1 "
        "FROM observation AS seen WHERE seen.run = entry.run AND seen.camera = entry.camera AND seen.n = entry.n) "
        "ORDER BY camera, n",
        (run,),
    )
    pending = []
    for camera, n, late_from_x_m, payload in found:
        track = TrackEntry.decode(payload).track
        if track is not None:
            pending.append(PendingTrack(camera, n, track, late_from_x_m))
    return pending
