"""Saves what is intact in a damaged ledger into a new file; the damaged one is kept beside it.

Every row that is as it was written is taken from wherever it lies, and one of which a single bit was flipped is put
right (`salvage`). What is gone is made again where other rows tell of it (`rebuild`); a damaged entry leaves an empty
row of kind 'lost', so that the logs stay numbered. Then each run is held against its sums: what cannot be saved is
named, and the total is smaller only where this says so.
"""

from __future__ import annotations

import math
import shutil
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import chain
from pathlib import Path

from aggregator.core.loads import LoadBook
from aggregator.ledger import rebuild
from aggregator.ledger.faults import explained
from aggregator.ledger.likeness import may_be_ledger, no_ledger
from aggregator.ledger.load_rows import SpanSums, event_from
from aggregator.ledger.rebuild import Expected, Repaired, Rows
from aggregator.ledger.receipt import Receipt, read_receipt, receipt_path
from aggregator.ledger.recount import recounted, recounted_spans
from aggregator.ledger.rows import body_from, tuber_from
from aggregator.ledger.salvage import Salvaged, salvaged
from aggregator.ledger.schema import (
    BATCH,
    ENTRY,
    FOREIGN,
    LOAD_EVENT,
    LOAD_TOTAL,
    OBSERVATION,
    RUN,
    SUMMARY,
    TABLES,
    TUBER,
    WRITTEN_ONCE,
    definition,
    row,
)
from aggregator.ledger.seal import break_seal
from aggregator.ledger.steps import first_step, span_step
from aggregator.ledger.sums import DEFAULT_STEP_G, RunSums
from aggregator.ledger.verified import named_key, unmade
from conveyor.errors import LedgerError, NoLedgerError, StorageError
from conveyor.files import cause


def repair(path: Path) -> Repaired:
    """Replace the ledger at `path` by a new one with everything that is intact in it.

    Raises:
        NoLedgerError: it is no ledger. LedgerError: nothing of it can be read, or the new file cannot be written. All
            is as it was then, and nothing was added beside it.
    """
    _check_worth(path)
    report = Repaired()
    fresh = path.with_name(path.name + ".repaired")
    acknowledged = _acknowledged(path)
    report.kept_as = _free_name(path)
    made = _not_there(path, report.kept_as)
    with Receipt(receipt_path(path)) as receipt, explained(path, "repairing"), _taken_back(made):
        _keep(path, report.kept_as)
        fresh.unlink(missing_ok=True)
        found = salvaged(path)
        rows, had = found.rows, rebuild.expected(found.rows)
        _tell(found, report)
        rebuild.runs(rows, had, report)
        if not rows[RUN.name]:
            raise LedgerError(f"no run can be read from {path}: there is nothing to save; it is as it was")
        rebuild.marks(rows, report)
        rebuild.observations(rows, report)
        rebuild.tubers(rows, report)
        rebuild.logs(rows, had, report)
        rebuild.events(rows, had, report)
        of_runs = rebuild.by_run(rows)
        rebuild.account(of_runs, had, found.version, report)
        _batches_missing(rows, had, acknowledged, list(of_runs)[-1], report)
        _leave_out_summaries(of_runs, had, report)
        book = LoadBook.of(event_from(event[:-1]) for event in rows[LOAD_EVENT.name])
        stretches = {run: _stretches(own, run, book, report) for run, own in of_runs.items()}
        seq = _number_batches(of_runs)
        sums = {run: _sums(own, had[run].sums if run in had else None) for run, own in of_runs.items()}
        for run in report.lossy & sums.keys():
            sums[run].lacks = True
        _write(fresh, of_runs, sums, stretches)
        made.clear()  # from here on the copy may be all that there is
        break_seal(receipt_path(path))
        _swap(path, fresh)
        receipt.write(seq)
        receipt.write(seq - 1)
    report.saved = {table.name: sum(len(own[table.name]) for own in of_runs.values()) for table in WRITTEN_ONCE}
    return report


def _check_worth(path: Path) -> None:
    """Refuse at once what is no ledger: to look through a large file for rows takes minutes.

    Raises:
        NoLedgerError: nothing in it is like one. LedgerError: no such file, or an empty one.
    """
    if not path.is_file():
        raise LedgerError(f"there is no ledger at {path}; give a run's folder or its ledger.db")
    log = path.with_name(path.name + "-wal")
    if not path.stat().st_size and not (log.exists() and log.stat().st_size):
        raise unmade(path)
    if not may_be_ledger(path):
        raise NoLedgerError(no_ledger(path))


def _acknowledged(path: Path) -> int:
    try:
        return read_receipt(receipt_path(path)) or 0
    except LedgerError:  # it is damaged too: a new one is written
        return 0


def _tell(found: Salvaged, report: Repaired) -> None:
    report.repaired += found.unread
    report.repaired += [f"{what}: one bit had changed, it was put back" for what in found.righted]
    for table in (table for table in TABLES if table.name in found.damaged):
        damaged = found.damaged[table.name]
        shown = "; ".join(named_key(table, values) for values in damaged[: rebuild.SHOWN])
        report.repaired.append(f"damaged rows of {table.name} were left out ({len(damaged)}): {shown}")


def _batches_missing(rows: Rows, had: Mapping[str, Expected], acknowledged: int, newest: str, report: Repaired) -> None:
    """`newest`: the run that was begun last, whose batches they were as far as is known."""
    told = sum(of.counts.get(BATCH.name, 0) for of in had.values())
    last = max([told, *(found[0] for found in rows[BATCH.name])])
    if last < acknowledged:
        lost = f"the newest {acknowledged - last} of {acknowledged} batches that were acknowledged"
        report.lost_of(newest, lost)


def _leave_out_summaries(of_runs: Mapping[str, Rows], had: Mapping[str, Expected], report: Repaired) -> None:
    """Of runs that lost something: they tell of what is no longer there."""
    again = "`tuberline ledger summary --config LINE.toml` writes it again"
    for run, own in of_runs.items():
        if not own[SUMMARY.name] and run in had and had[run].counts.get(SUMMARY.name):
            report.lost_of(run, f"the summary of run {run}, which is not finished therefore: {again}")
        elif own[SUMMARY.name] and run in report.less:
            own[SUMMARY.name] = []
            report.repaired.append(f"the summary of run {run} told of what is lost now and was left out: {again}")


def _number_batches(of_runs: Mapping[str, Rows]) -> int:
    """One batch per run, with what is there now; the line stays where it was."""
    for seq, (run, own) in enumerate(of_runs.items(), start=1):
        places = [batch[2] for batch in own[BATCH.name][-1:]]
        places += [tuber[3] for tuber in own[TUBER.name]]  # none was committed before the line stood there
        counts = [len(own[name]) for name in (ENTRY.name, TUBER.name, OBSERVATION.name)]
        own[BATCH.name] = [row((seq, run, min(places, default=math.inf), *counts))]
    return len(of_runs)


def _write(
    path: Path,
    of_runs: Mapping[str, Rows],
    sums: Mapping[str, RunSums],
    stretches: Mapping[str, dict[int, SpanSums]],
) -> None:
    db = sqlite3.connect(path, isolation_level=None)
    try:
        db.execute("PRAGMA synchronous = FULL")
        db.execute("BEGIN IMMEDIATE")
        for statement in definition():
            db.execute(statement)
        for run, own in of_runs.items():
            for table in WRITTEN_ONCE:
                db.executemany(table.insert, own[table.name])
            first_step(db, run, sums[run])
            for n, span in stretches[run].items():
                span_step(db, run, n, span)
        db.execute("COMMIT")
    finally:
        db.close()


def _sums(own: Rows, old: RunSums | None) -> RunSums:
    """The sums of a run, added up again; what its cameras looked at is as intact old sums have it, else by marks."""
    rows = [(table, [found[:-1] for found in own[table.name]]) for table in WRITTEN_ONCE]
    sums = recounted(rows, histogram_step_g=old.load.histogram_step_g if old else DEFAULT_STEP_G)
    sums.sights = old.sights if old else rebuild.sights(own)
    sums.head_start_m, sums.turns = (old.head_start_m, old.turns) if old else (None, [])
    sums.stopped, sums.utc_offset_s = (old.stopped, old.utc_offset_s) if old else (False, None)
    sums.lacks = old is not None and old.lacks
    return sums


def _stretches(own: Rows, run: str, book: LoadBook, report: Repaired) -> dict[int, SpanSums]:
    """The sums of each stretch of a run's belt, added up again; what was seen of it as intact old sums have it."""
    tubers = (tuber_from(found[:-1]) for found in own[TUBER.name])
    bodies = (body_from(found[:-1]) for found in own[FOREIGN.name])
    old = {found[1]: SpanSums.from_text(found[3]) for found in own[LOAD_TOTAL.name]}
    step_g = next((sums.load.histogram_step_g for sums in old.values()), DEFAULT_STEP_G)
    counted = recounted_spans(chain(tubers, bodies), book.spans.get(run, []), histogram_step_g=step_g)
    unknown = [n for n in counted if n not in old]
    if unknown:
        report.lost_of(
            run,
            f"what was seen of the stretches of belt of run {run} that events {rebuild.listed(unknown)} of loads began",
        )
    return {n: SpanSums(load, old[n].seen if n in old else None) for n, load in counted.items()}


def _free_name(path: Path) -> Path:
    """Where the damaged ledger is kept."""
    n = 1
    while (kept := path.with_name(f"{path.name}.damaged-{n}")).exists():
        n += 1
    return kept


def _not_there(path: Path, kept: Path) -> list[Path]:
    """What a repair may make beside `path` and is not there before it."""
    logs = [path.with_name(path.name + suffix) for suffix in ("-wal", "-shm")]
    fresh = [path.with_name(path.name + suffix) for suffix in (".repaired", ".repaired-journal")]
    copies = [kept, kept.with_name(kept.name + "-wal")]
    return [file for file in (*logs, *fresh, *copies, receipt_path(path)) if not file.exists()]


@contextmanager
def _taken_back(made: list[Path]) -> Iterator[None]:
    """Where the block raises or is stopped the files are removed that `made` has then."""
    try:
        yield
    except BaseException:
        for file in made:
            with suppress(OSError):
                file.unlink(missing_ok=True)
        raise


def _keep(path: Path, kept: Path) -> None:
    """Copy the ledger and its log under a new name before anything is touched."""
    try:
        for suffix in ("", "-wal"):
            source = path.with_name(path.name + suffix)
            if source.exists():
                shutil.copy2(source, kept.with_name(kept.name + suffix))
    except OSError as error:
        raise StorageError(f"{path} cannot be copied to {kept}: {cause(error)}") from error


def _swap(path: Path, fresh: Path) -> None:
    """Put `fresh` in the place of the ledger at `path`, whose log must not be applied to it."""
    try:
        for suffix in ("-wal", "-shm"):
            path.with_name(path.name + suffix).unlink(missing_ok=True)
        fresh.replace(path)
    except OSError as error:
        raise LedgerError(f"{fresh} cannot take the place of {path}: {error.strerror}") from error
