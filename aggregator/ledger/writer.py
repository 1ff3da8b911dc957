"""The ledger's writer: one SQLite file per output folder, one transaction per batch, durable before it is acknowledged.

WAL with synchronous=FULL: a commit is on the disk when `write` returns. Opening verifies what it reads (runs, sums, the
newest batch, the receipt) at a cost that does not grow with the ledger, and refuses one that cannot be trusted; nothing
is ever repaired silently. The whole is verified by `tuberline ledger check` and `tuberline audit`.
"""

from __future__ import annotations

import json
import math
import os
import sqlite3
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from aggregator.core.foreign import ForeignBody
from aggregator.core.load_sums import RATE_TUBERS, LoadSums
from aggregator.core.loads import LoadBook, LoadEvent
from aggregator.core.machine import Batch, Restored
from aggregator.core.sight import CameraSight
from aggregator.ledger.check import opening_faults
from aggregator.ledger.committed import RunTubers
from aggregator.ledger.faults import explained
from aggregator.ledger.goes_on import check_goes_on
from aggregator.ledger.load_keeper import LoadKeeper
from aggregator.ledger.load_rows import SpanSums
from aggregator.ledger.migrate import migrate
from aggregator.ledger.reader import RunRow, read_bodies, read_last_batch, read_run, read_runs, read_sums, read_tubers
from aggregator.ledger.receipt import Receipt, read_receipt, receipt_path
from aggregator.ledger.resume import restore
from aggregator.ledger.rows import body_row, coverage_row, entry_row, observation_row, tuber_row
from aggregator.ledger.schema import (
    BATCH,
    COVERAGE,
    ENTRY,
    FOREIGN,
    OBSERVATION,
    RUN,
    SCHEMA_VERSION,
    SUMMARY,
    TUBER,
    definition,
    row,
)
from aggregator.ledger.seal import break_seal, set_seal
from aggregator.ledger.steps import first_step, next_step
from aggregator.ledger.sums import RunSums
from aggregator.ledger.verified import LedgerView, unmade
from conveyor.errors import LedgerError, StorageError
from conveyor.files import cause, may_pass
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
        self._sums: dict[str, RunSums] = {}

    def __enter__(self) -> Self:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            text = f"folder {self.path.parent} for the ledger (aggregator.out) cannot be made: {cause(error)}"
            raise (StorageError(text) if may_pass(error) else LedgerError(text)) from error
        if self.path.exists() and self.path.stat().st_size and not os.access(self.path, os.W_OK):
            raise StorageError(f"ledger {self.path} is read-only; give the user write access to it and to its folder")
        acknowledged = read_receipt(receipt_path(self.path))
        if acknowledged is None and self.path.exists():
            self._refuse_unacknowledged()
        self._receipt.__enter__()
        try:
            break_seal(receipt_path(self.path))
            with explained(self.path, "opening"):
                self._db = sqlite3.connect(self.path, isolation_level=None, timeout=BUSY_TIMEOUT_S)
                self._loads = LoadKeeper(self._db, lambda: self.view, self._step)
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
        try:
            if kind is None:
                set_seal(self.path, receipt_path(self.path))
        finally:
            self._receipt.__exit__(None, None, None)

    def _refuse_unacknowledged(self) -> None:
        """Batches without a receipt are refused before one is made: the next start would find it and go on.

        A process that was killed while it made the file leaves a journal, and only who may write can roll it back.
        """
        being_made = self.path.with_name(f"{self.path.name}-journal").exists()
        uri = f"{self.path.resolve().as_uri()}?mode={'rw' if being_made else 'ro'}"
        with explained(self.path, "opening"), closing(sqlite3.connect(uri, uri=True)) as db:
            if db.execute("SELECT 1 FROM sqlite_master").fetchone():
                self._refuse(opening_faults(LedgerView(db, self.path), acknowledged=None))

    def _refuse(self, faults: Sequence[str]) -> None:
        if faults:
            shown = "\n".join(f"  {fault}" for fault in faults[:10])
            raise LedgerError(
                f"ledger {self.path} cannot be trusted:\n{shown}\n`tuberline ledger repair {self.path}` saves what is "
                "intact into a new file and keeps this one"
            )

    def _prepare(self, acknowledged: int | None) -> None:
        self._db.execute("PRAGMA journal_mode = WAL")
        self._db.execute("PRAGMA synchronous = FULL")
        if acknowledged is None:  # no batch is there yet
            self._receipt.write(0)
        if not self._db.execute("SELECT 1 FROM sqlite_master").fetchone():
            if acknowledged:
                raise unmade(self.path)
            self._create()
        self.view = LedgerView(self._db, self.path)
        self._refuse(opening_faults(self.view, acknowledged=acknowledged))
        if self.view.version < SCHEMA_VERSION:
            with self._transaction("migration"):
                migrate(self._db, self.view, self._step)
            self.view = LedgerView(self._db, self.path)
        self._seq = self.view.last_seq()

    def _create(self) -> None:
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
        histogram_step_g: float = 50.0,
        utc_offset_s: int | None = None,
    ) -> Restored:
        """Begin `run`, or go on with it where the ledger holds it; its state is rebuilt from the ledger alone.

        Args:
            fingerprint: of the recording, where there is one; the same recording is not counted twice into one ledger.
            may_be_finished: go on with a finished run (its entries are all duplicates) instead of refusing it.
            histogram_step_g: width of a weight class, grams; another one than before is counted again from all tubers.
            utc_offset_s: of the line's clock at `started_ns`; None: not known.

        Raises:
            LedgerError: the run is finished, has other cameras, or its recording is in the ledger under another run.
        """
        with explained(self.path, f"opening run {run}"):
            known = read_run(self.view, run)
            if known is None:
                self._refuse_same_recording(run, fingerprint)
                begun = row((run, line, json.dumps(sorted(cameras)), fingerprint, version, started_ns))
                self._begin(run, begun, RunSums(LoadSums(histogram_step_g), utc_offset_s=utc_offset_s))
                return Restored()
            check_goes_on(known, self.path, cameras=cameras, may_be_finished=may_be_finished)
            return restore(self.view, known, self._go_on(run, histogram_step_g))

    def _begin(self, run: str, begun: tuple[Any, ...], sums: RunSums) -> None:
        sums.add_rows(RUN, [begun])
        with self._transaction("run"):
            self._db.execute(RUN.insert, begun)
            first_step(self._db, run, sums)
        self._sums[run] = sums

    def _go_on(self, run: str, histogram_step_g: float) -> RunSums:
        sums = read_sums(self.view, run)
        if sums.stopped:
            sums.stopped = False
            with self._transaction("going on"):
                next_step(self._db, run, sums)
        carried = [sums.load, *(stretch.load for stretch in self._loads.sums(run).values())]
        if any(load.histogram_step_g != histogram_step_g for load in carried):
            with self._transaction("classes"):
                self._count_again(run, sums, histogram_step_g)
        else:
            for tuber in read_tubers(self.view, run, since=max(0, sums.last_tuber_id - RATE_TUBERS)):
                sums.load.passed(tuber.crossed_ns)
        self._sums[run] = sums
        return sums

    def _count_again(self, run: str, sums: RunSums, histogram_step_g: float) -> None:
        """All tubers in classes of another width: the sums of the run and of its stretches change together."""

        def tubers() -> Iterator[Tuber | ForeignBody]:
            yield from read_tubers(self.view, run)
            yield from read_bodies(self.view, run)

        sums.load = LoadSums(histogram_step_g)
        for tuber in tubers():
            sums.load.add(tuber)
        self._loads.count_again(run, tubers, histogram_step_g)
        next_step(self._db, run, sums)

    def _refuse_same_recording(self, run: str, fingerprint: str) -> None:
        found = next((known for known in read_runs(self.view) if known.fingerprint == fingerprint), None)
        if fingerprint and found:
            raise LedgerError(
                f"ledger {self.path} already holds this recording ({fingerprint}) as run '{found.run}': counting it as "
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
        sums = self.sums(run)
        marks = [(a.logged.entry.camera, a.logged.entry.n, a.logged.entry.mark) for a in batch.entries]
        added = {
            ENTRY: [entry_row(applied) for applied in batch.entries],
            COVERAGE: [coverage_row(run, camera, n, mark) for camera, n, mark in marks if mark is not None],
            TUBER: [tuber_row(tuber) for tuber in batch.tubers],
            OBSERVATION: [observation_row(run, seen) for seen in batch.observations],
            FOREIGN: [body_row(body) for body in batch.bodies],
        }
        for table, rows in added.items():
            self._db.executemany(table.insert, rows)
            sums.add_rows(table, rows)
            self._step(f"{table.name} written")
        sums.add_batch(batch)
        self._loads.count(run, [*batch.tubers, *batch.bodies])
        self._number(run, sums, batch.watermark_x_m)

    def _number(self, run: str, sums: RunSums, watermark_x_m: float) -> None:
        """The row of a batch, and the sums after it."""
        counts = [sums.count(table) for table in (ENTRY, TUBER, OBSERVATION)]
        written = row((self._seq + 1, run, watermark_x_m, *counts))
        self._db.execute(BATCH.insert, written)
        sums.add_rows(BATCH, [written])
        self._step("batch written")
        next_step(self._db, run, sums)
        self._step("sums written")

    def say(self, event: LoadEvent) -> None:
        """Make an event of a load durable; when this returns, it may be acknowledged. One that is there changes
        nothing.

        Raises:
            LedgerError: it could not be written. Nothing of it was, and it may not be acknowledged.
        """
        if event.request in self.loads.events:
            return
        with explained(self.path, "writing what was said of a load"):
            with self._transaction("batch"):
                last, sums = read_last_batch(self.view, event.run), self.sums(event.run)
                self._loads.say(event, sums)
                self._number(event.run, sums, last[2] if last else math.inf)
            self._step("before receipt")
            self._receipt.write(self._seq)
            self._step("after receipt")

    @property
    def loads(self) -> LoadBook:
        """All that was said of loads, as committed."""
        return self._loads.book

    def span_sums(self, run: str) -> Mapping[int, SpanSums]:
        """The sums of each stretch of `run`, as committed; empty where no load changed in it."""
        return self._loads.sums(run)

    def finish(self, run: str, summary: str, *, sights: Mapping[str, CameraSight] | None = None) -> None:
        """Keep the summary of a run that ended; the run takes nothing more. A second time changes nothing."""
        with explained(self.path, f"finishing run {run}"), self._transaction("summary"):
            known = read_run(self.view, run)
            if known is not None and not known.finished:
                sums, written = self.sums(run), row((run, summary))
                sums.sights = dict(sights) if sights is not None else sums.sights
                self._db.execute(SUMMARY.insert, written)
                sums.add_rows(SUMMARY, [written])
                self._loads.settle(run, sums)
                next_step(self._db, run, sums)

    def stopped(self, run: str, sights: Mapping[str, CameraSight]) -> None:
        """Keep that a run's line is stopped, and what was looked at by then (`coverage.at_rest`); it may go on later.

        Raises:
            LedgerError: it could not be written.
        """
        with explained(self.path, f"stopping run {run}"), self._transaction("stop"):
            known = read_run(self.view, run)
            if known is not None and not known.finished:
                sums = self.sums(run)
                sums.sights, sums.stopped = dict(sights), True
                next_step(self._db, run, sums)

    def _transaction(self, name: str) -> _Transaction:
        return _Transaction(self, name)

    def _forget(self) -> None:
        """Sums may hold what was not written: the next one reads them again."""
        self._sums.clear()
        self._loads.forget()

    def sums(self, run: str) -> RunSums:
        """The sums of `run` as committed."""
        if run not in self._sums:
            self._sums[run] = read_sums(self.view, run)
        return self._sums[run]

    def run_row(self, run: str) -> RunRow | None:
        """The run of that id."""
        return read_run(self.view, run)

    def runs(self) -> list[RunRow]:
        """All runs in the order they were begun."""
        return read_runs(self.view)

    def tubers(self, run: str) -> Iterator[Tuber]:
        """All committed tubers of `run`, by id."""
        return read_tubers(self.view, run)

    def committed(self, run: str) -> RunTubers:
        """What the core may ask about `run`."""
        return RunTubers(self.view, run)


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
                self._ledger._forget()
                if db.in_transaction:
                    db.execute("ROLLBACK")
                raise
            if self._name == "batch":
                self._ledger._seq += 1
            self._ledger._step(f"after commit of {self._name}")
        else:
            self._ledger._forget()
            if db.in_transaction:
                db.execute("ROLLBACK")
