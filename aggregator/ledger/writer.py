"""The ledger's writer: one SQLite file per output folder, one transaction per batch, durable before it is acknowledged.

WAL with synchronous=FULL: a commit is on the disk when `write` returns. Opening checks everything there is to check and
refuses a ledger that cannot be trusted; nothing is ever mended silently.
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from aggregator.core.machine import Batch, CommittedTuber, Restored
from aggregator.ledger.check import ledger_faults
from aggregator.ledger.faults import explained
from aggregator.ledger.reader import RunRow, check_version, read_run, read_tubers, restore
from aggregator.ledger.receipt import Receipt, read_receipt, receipt_path
from aggregator.ledger.rows import coverage_row, entry_row, observation_row, tuber_row
from aggregator.ledger.schema import BATCH, COVERAGE, ENTRY, OBSERVATION, RUN, SUMMARY, TUBER, definition, row
from conveyor.errors import LedgerError, StorageError
from conveyor.messages import Tuber

BUSY_TIMEOUT_S = 5.0


class Ledger:
    """The open ledger at `path`; there is one writer at a time. Use as a context manager.

    Args:
        path: the SQLite file; made, with its folder, where it does not exist.
        step: called with a name before and after each write; lets a test kill the process at any of them.

    Raises (on entering):
        LedgerError: not a ledger, of another version, damaged, shorter than what was acknowledged, in use, unwritable.
    """

    def __init__(self, path: Path, *, step: Callable[[str], None] = lambda name: None) -> None:
        self.path = path
        self._step = step
        self._receipt = Receipt(receipt_path(path))
        self._seq = 0

    def __enter__(self) -> Self:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StorageError(f"folder {self.path.parent} for the ledger cannot be made: {error.strerror}") from error
        if self.path.exists() and self.path.stat().st_size and not os.access(self.path, os.W_OK):
            raise StorageError(f"ledger {self.path} is read-only; give the user write access to it and to its folder")
        acknowledged = read_receipt(receipt_path(self.path))
        self._receipt.__enter__()
        try:
            with explained(self.path, "opening"):
                self._db = sqlite3.connect(self.path, isolation_level=None, timeout=BUSY_TIMEOUT_S)
                try:
                    self._prepare(acknowledged)
                except BaseException:
                    self._db.close()
                    raise
        except BaseException:
            self._receipt.__exit__(None, None, None)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._db.close()
        self._receipt.__exit__(None, None, None)

    def _prepare(self, acknowledged: int | None) -> None:
        self._db.execute("PRAGMA journal_mode = WAL")
        self._db.execute("PRAGMA synchronous = FULL")
        if not self._db.execute("SELECT 1 FROM sqlite_master").fetchone():
            if acknowledged:
                raise LedgerError(
                    f"ledger {self.path} is empty, but {acknowledged} batches of it were acknowledged: the file was "
                    f"lost; bring it back, or remove {receipt_path(self.path)} too and start anew"
                )
            self._create()
        check_version(self._db, self.path)
        faults = ledger_faults(self._db, acknowledged=acknowledged, deep=False)
        if faults:
            shown = "\n".join(f"  {fault}" for fault in faults[:10])
            raise LedgerError(
                f"ledger {self.path} cannot be trusted:\n{shown}\n`tuberline ledger repair {self.path}` saves what is "
                "intact into a new file and keeps this one"
            )
        self._seq = self._db.execute("SELECT coalesce(max(seq), 0) FROM batch").fetchone()[0]

    def _create(self) -> None:
        self._receipt.write(0)
        self._receipt.write(0)
        with self._transaction("create"):
            for statement in definition():
                self._db.execute(statement)

    def open_run(
        self,
        run: str,
        *,
        line: str,
        cameras: Sequence[str],
        version: str,
        started_ns: int,
        fingerprint: str = "",
        may_be_finished: bool = False,
    ) -> Restored:
        """Begin `run`, or go on with it where the ledger holds it; its state is rebuilt from the ledger alone.

        Args:
            fingerprint: of the recording, where there is one; the same recording is not counted twice into one ledger.
            may_be_finished: go on with a finished run (its entries are all duplicates) instead of refusing it.

        Raises:
            LedgerError: the run is finished, has other cameras, or its recording is in the ledger under another run.
        """
        with explained(self.path, f"opening run {run}"):
            known = read_run(self._db, run)
            if known is None:
                self._refuse_same_recording(run, fingerprint)
                with self._transaction("run"):
                    names = json.dumps(sorted(cameras))
                    self._db.execute(RUN.insert, row((run, line, names, fingerprint, version, started_ns)))
                return Restored()
            if known.finished and not may_be_finished:
                raise LedgerError(
                    f"ledger {self.path} already holds run '{run}', finished: counting it again would count every "
                    "tuber twice; give another --run, or another aggregator.out"
                )
            if list(known.cameras) != sorted(cameras):
                raise LedgerError(
                    f"run '{run}' in ledger {self.path} was begun with cameras {', '.join(known.cameras)}, the config "
                    f"has {', '.join(sorted(cameras))}; mend the config or give another --run"
                )
            return restore(self._db, run)

    def _refuse_same_recording(self, run: str, fingerprint: str) -> None:
        if not fingerprint:
            return
        found = self._db.execute("SELECT run FROM run WHERE fingerprint = ? LIMIT 1", (fingerprint,)).fetchone()
        if found:
            raise LedgerError(
                f"ledger {self.path} already holds this recording ({fingerprint}) as run '{found[0]}': counting it as "
                f"run '{run}' too would count every tuber twice; give --new-run if that is wanted"
            )

    def write(self, run: str, batch: Batch) -> None:
        """Make `batch` durable; when this returns, its entries may be acknowledged.

        Raises:
            LedgerError: it could not be written. Nothing of it was, and nothing of it may be acknowledged.
        """
        with explained(self.path, "committing a batch"):
            with self._transaction("batch"):
                self._insert(run, batch)
            self._step("before receipt")
            self._receipt.write(self._seq)
            self._step("after receipt")

    def _insert(self, run: str, batch: Batch) -> None:
        marks = [(a.logged.entry.camera, a.logged.entry.n, a.logged.entry.mark) for a in batch.entries]
        self._db.executemany(ENTRY.insert, [entry_row(applied) for applied in batch.entries])
        self._step("entries written")
        self._db.executemany(
            COVERAGE.insert, [coverage_row(run, camera, n, mark) for camera, n, mark in marks if mark is not None]
        )
        self._db.executemany(TUBER.insert, [tuber_row(tuber) for tuber in batch.tubers])
        self._step("tubers written")
        self._db.executemany(OBSERVATION.insert, [observation_row(run, seen) for seen in batch.observations])
        self._step("observations written")
        entries, tubers, observations = self._counts(run)
        self._db.execute(
            BATCH.insert,
            row(
                (
                    self._seq + 1,
                    run,
                    batch.line_x_m,
                    entries + len(batch.entries),
                    tubers + len(batch.tubers),
                    observations + len(batch.observations),
                )
            ),
        )
        self._step("batch written")

    def _counts(self, run: str) -> tuple[int, int, int]:
        last = self._db.execute(
            "SELECT entries, tubers, observations FROM batch WHERE run = ? ORDER BY seq DESC LIMIT 1", (run,)
        ).fetchone()
        return last or (0, 0, 0)

    def finish(self, run: str, summary: str) -> None:
        """Keep the summary of a run that ended; the run takes nothing more. A second time changes nothing."""
        with explained(self.path, f"finishing run {run}"), self._transaction("summary"):
            if not self._db.execute("SELECT 1 FROM summary WHERE run = ?", (run,)).fetchone():
                self._db.execute(SUMMARY.insert, row((run, summary)))

    def _transaction(self, name: str) -> _Transaction:
        return _Transaction(self, name)

    @property
    def connection(self) -> sqlite3.Connection:
        """The open database, for reading."""
        return self._db

    def run_row(self, run: str) -> RunRow | None:
        """The run of that id."""
        return read_run(self._db, run)

    def tubers(self, run: str) -> Iterator[Tuber]:
        """All committed tubers of `run`, by id."""
        return read_tubers(self._db, run)

    def committed(self, run: str) -> RunTubers:
        """What the core may ask about `run`."""
        return RunTubers(self._db, run)


class _Transaction:
    """BEGIN IMMEDIATE ... COMMIT, or ROLLBACK on any error; a batch's number is taken on success only."""

    def __init__(self, ledger: Ledger, name: str) -> None:
        self._ledger = ledger
        self._name = name

    def __enter__(self) -> None:
        self._ledger._step(f"before {self._name}")
        self._ledger._db.execute("BEGIN IMMEDIATE")

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        db = self._ledger._db
        if kind is None:
            try:
                self._ledger._step(f"before commit of {self._name}")
                db.execute("COMMIT")
            except BaseException:
                if db.in_transaction:
                    db.execute("ROLLBACK")
                raise
            if self._name == "batch":
                self._ledger._seq += 1
            self._ledger._step(f"after commit of {self._name}")
        elif db.in_transaction:
            db.execute("ROLLBACK")


class RunTubers:
    """Committed tubers of one run, asked by place or by track (`aggregator.core.CommittedTubers`)."""

    def __init__(self, db: sqlite3.Connection, run: str) -> None:
        self._db = db
        self._run = run

    def near(self, low_x_m: float, high_x_m: float) -> Sequence[CommittedTuber]:
        """Committed tubers whose place lies between the two, by id."""
        found = self._db.execute(
            "SELECT tuber_id, place_x_m, place_y_m FROM tuber WHERE run = ? AND place_x_m BETWEEN ? AND ? "
            "ORDER BY tuber_id",
            (self._run, low_x_m, high_x_m),
        ).fetchall()
        return [CommittedTuber(tuber_id, x_m, y_m, self._members(tuber_id)) for tuber_id, x_m, y_m in found]

    def _members(self, tuber_id: int) -> tuple[tuple[str, int, int], ...]:
        return tuple(
            self._db.execute(
                "SELECT camera, first_seq, last_seq FROM observation WHERE run = ? AND tuber_id = ? "
                "AND role != 'repeat' ORDER BY camera, n",
                (self._run, tuber_id),
            )
        )

    def knows_track(self, track_id: str) -> bool:
        """A track of that id is in the ledger."""
        return (
            self._db.execute(
                "SELECT 1 FROM observation WHERE run = ? AND track_id = ? AND role != 'repeat'", (self._run, track_id)
            ).fetchone()
            is not None
        )
