"""Whether a ledger can be trusted: SQLite's own check, every row's checksum, sums that must agree, the seal."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path

from aggregator.core.load_sums import LoadSums
from aggregator.core.loads import Span
from aggregator.ledger.faults import DAMAGE
from aggregator.ledger.load_rows import read_book, read_span_sums
from aggregator.ledger.reader import read_bodies, read_last_batch, read_runs, read_sums, read_tubers
from aggregator.ledger.receipt import receipt_path
from aggregator.ledger.recount import recount, recounted_spans
from aggregator.ledger.schema import (
    ENTRY,
    LOAD_EVENT,
    LOAD_TOTAL,
    MOVING,
    OBSERVATION,
    RUN,
    TABLES,
    TUBER,
    WRITTEN_ONCE,
)
from aggregator.ledger.seal import seal_faults
from aggregator.ledger.sums import RunSums
from aggregator.ledger.verified import LedgerView, named_key, reading
from conveyor.errors import LedgerError, NoLedgerError, StorageError, UnmadeError

_SHOWN = 5
_TO_CHECK = re.compile(r"[;:] see `tuberline ledger check`|`tuberline ledger check` lists (the|all) damage, ")
"""The advice, in what reading a ledger says, to do what is done here."""


def check_file(path: Path) -> list[str]:
    """Everything wrong with the ledger at `path` and its receipt, in words; every row and index is checked.

    Raises:
        LedgerError: there is no such file, it is no ledger, or no aggregator has made one of it yet.
        StorageError: it cannot be read now, for its disk is full say, which says nothing of the ledger.
    """
    if not path.is_file():
        raise LedgerError(f"there is no ledger at {path}; give a run's folder or its ledger.db")
    try:
        with reading(path) as view:
            return view_faults(view)
    except DAMAGE as error:
        return [f"it cannot be read at all: {error}"]
    except (NoLedgerError, UnmadeError, StorageError):
        raise
    except LedgerError as error:
        return [_told(error)]


def view_faults(view: LedgerView) -> list[str]:
    """The same through an open view; with the receipt and the seal beside the file."""
    receipt = receipt_path(view.path)
    try:
        acknowledged = view.receipt()
    except LedgerError as error:
        return [_told(error)]
    return [*ledger_faults(view, acknowledged=acknowledged), *seal_faults(view.path, receipt)]


def ledger_faults(view: LedgerView, *, acknowledged: int | None, receipt: bool = True) -> list[str]:
    """Everything wrong with the ledger's contents, in words; empty where all is well.

    Args:
        acknowledged: last acknowledged batch according to the receipt; None where there is no receipt.
        receipt: hold the ledger against its receipt at all.
    """
    faults = [f"damaged pages: {said}" for (said,) in view.pragma("integrity_check") if said != "ok"]
    rows = _collected(_row_faults, view)
    faults += rows
    for part in (_log_faults, _reference_faults):
        faults += _collected(part, view)
    if not rows:  # what follows would say the same again, once a table
        faults += _collected(_sum_faults, view)
    return faults + (_collected(lambda view: _receipt_faults(view, acknowledged), view) if receipt else [])


def opening_faults(view: LedgerView, *, acknowledged: int | None) -> list[str]:
    """What a writer looks at before it goes on: runs, sums, the newest batches, the receipt. Its cost does not grow
    with the ledger, but for one of version 1.
    """
    return _collected(_opening_faults, view) + _collected(lambda view: _receipt_faults(view, acknowledged), view)


def _told(error: LedgerError) -> str:
    return _TO_CHECK.sub("", str(error))


def _collected(part: Callable[[LedgerView], Iterable[str]], view: LedgerView) -> list[str]:
    """What `part` finds until the damage stops it, and that it did."""
    faults: list[str] = []
    try:
        faults.extend(part(view))
    except StorageError:
        raise
    except LedgerError as error:
        faults.append(_told(error))
    except DAMAGE as error:
        faults.append(f"reading stopped: {error}")
    return faults


def _opening_faults(view: LedgerView) -> Iterator[str]:
    for known in read_runs(view):
        batch = read_last_batch(view, known.run)
        if view.version >= 2:
            yield from _against_batch(known.run, read_sums(view, known.run), batch[3:6] if batch else (0, 0, 0))


def _against_batch(run: str, sums: RunSums, said: Iterable[int]) -> Iterator[str]:
    for table, expected in zip((ENTRY, TUBER, OBSERVATION), said, strict=True):
        if sums.count(table) != expected:
            yield f"run {run} has {sums.count(table)} rows of {table.name} by its sums, its last batch says {expected}"


def _row_faults(view: LedgerView) -> Iterator[str]:
    for table in TABLES:
        bad = 0
        try:
            for found, sound in view.scan(table):
                bad += not sound
                if not sound and bad <= _SHOWN:
                    yield f"row of {table.name} with a wrong checksum: {named_key(table, found)}"
        except LedgerError as error:
            yield f"table {table.name} cannot be read to its end: {_told(error)}"
        if bad > _SHOWN:
            yield f"{bad - _SHOWN} more rows of {table.name} with a wrong checksum"


def _log_faults(view: LedgerView) -> Iterator[str]:
    logs = view.tally("SELECT run, camera, count(*), min(n), max(n) FROM entry GROUP BY run, camera")
    for run, camera, count, first, last in logs:
        if (first, count) != (1, last):
            yield f"log of {camera} in run {run} has {count} entries between {first} and {last}: some are missing"
    ((count, last),) = view.tally("SELECT count(*), coalesce(max(seq), 0) FROM batch")
    if last != count:
        yield f"{count} batches are there, the last is number {last}: some are missing"
    if view.version >= LOAD_EVENT.since:
        ((count, last),) = view.tally("SELECT count(*), coalesce(max(n), 0) FROM load_event")
        if last != count:
            yield f"{count} events of loads are there, the last is number {last}: some are missing"


def _sum_faults(view: LedgerView) -> Iterator[str]:
    """The rows, added up, against the sums carried along and against the last batch."""
    runs = {known.run for known in read_runs(view)}
    for table in (*(t for t in WRITTEN_ONCE if t is not RUN), *MOVING):
        if view.version < table.since:
            continue
        strays = {run for (run,) in view.tally(f"SELECT DISTINCT run FROM {table.name}")} - runs
        if strays:
            named = ", ".join(sorted(map(str, strays))[:_SHOWN])
            yield f"rows of {table.name} belong to runs that are not there: {named}"
    spans = read_book(view).spans
    for run in sorted(runs):
        step_g = read_sums(view, run).load.histogram_step_g if view.version >= 2 else 50.0
        counted = recount(view, run, histogram_step_g=step_g)
        batch = read_last_batch(view, run)
        for table, expected in zip((ENTRY, TUBER, OBSERVATION), batch[3:6] if batch else (0, 0, 0), strict=True):
            if counted.count(table) != expected:
                yield f"run {run} has {counted.count(table)} rows of {table.name}, its last batch says {expected}"
        if view.version >= 2:
            yield from _differences(run, counted, read_sums(view, run))
        if view.version >= LOAD_TOTAL.since:
            yield from _span_differences(view, run, spans.get(run, []), step_g)


def _differences(run: str, counted: RunSums, carried: RunSums) -> Iterator[str]:
    for table in WRITTEN_ONCE:
        (rows, crcs), (said, said_crcs) = counted.rows[table.name], carried.rows[table.name]
        if rows != said:
            yield f"run {run} has {rows} rows of {table.name}, its sums say {said}"
        elif crcs != said_crcs:
            yield f"run {run}: the rows of {table.name} are not those that its sums were made of"
    for name in ("tracks", "roles", "repeats", "counted", "last_tuber_id", "last_body_id"):
        if getattr(counted, name) != getattr(carried, name):
            yield f"run {run}: {name} come to {getattr(counted, name)}, its sums say {getattr(carried, name)}"
    if not counted.load.same_as(carried.load):
        yield f"run {run}: the tubers' weights do not come to what its sums say"


def _span_differences(view: LedgerView, run: str, spans: Sequence[Span], step_g: float) -> Iterator[str]:
    """The tubers of each stretch of belt, added up by their places, against the sums carried along."""
    carried = read_span_sums(view, run)
    counted = recounted_spans(chain(read_tubers(view, run), read_bodies(view, run)), spans, histogram_step_g=step_g)
    for n in sorted({*carried, *counted}):
        mine = counted.get(n) or LoadSums(step_g)  # a stretch whose change was undone keeps its row, empty
        if n not in carried:
            yield f"run {run} has no sums of its stretch of belt {n}"
        elif not mine.same_as(carried[n].load):
            yield f"run {run}: the tubers of its stretch of belt {n} do not come to what its sums say"


_ORPHANS = (
    (
        "tubers that no track was counted for",
        "SELECT count(*) FROM tuber WHERE NOT EXISTS (SELECT 1 FROM observation AS seen WHERE seen.run = tuber.run "
        "AND seen.tuber_id = tuber.tuber_id AND seen.role = 'counted')",
    ),
    (
        "observations of tubers that are not there",
        "SELECT count(*) FROM observation WHERE tuber_id IS NOT NULL AND NOT EXISTS (SELECT 1 FROM tuber WHERE "
        "tuber.run = observation.run AND tuber.tuber_id = observation.tuber_id)",
    ),
    (
        "observations of entries that are not there",
        "SELECT count(*) FROM observation WHERE NOT EXISTS (SELECT 1 FROM entry WHERE entry.run = observation.run "
        "AND entry.camera = observation.camera AND entry.n = observation.n)",
    ),
)


def _reference_faults(view: LedgerView) -> Iterator[str]:
    for what, sql in _ORPHANS:
        ((count,),) = view.tally(sql)
        if count:
            yield f"{count} {what}"


def _receipt_faults(view: LedgerView, acknowledged: int | None) -> Iterator[str]:
    last = view.last_seq()
    if acknowledged is None and last:
        yield f"its receipt (.ack) is missing, so it is unknown whether all of {last} batches are there"
    if acknowledged is not None and last < acknowledged:
        yield f"{acknowledged} batches were acknowledged, only {last} are there: the newest commits are lost"
