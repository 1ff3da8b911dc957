"""Whether a ledger can be trusted: SQLite's own check, every row's checksum, and counts that must agree."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path

from aggregator.ledger.faults import DAMAGE
from aggregator.ledger.receipt import read_receipt, receipt_path
from aggregator.ledger.schema import APPLICATION_ID, SCHEMA_VERSION, TABLES, checksum
from conveyor.errors import LedgerError

_SHOWN = 5


def check_file(path: Path) -> list[str]:
    """Everything wrong with the ledger at `path` and its receipt, in words; every index is checked too.

    Raises:
        LedgerError: there is no such file.
    """
    if not path.is_file():
        raise LedgerError(f"there is no ledger at {path}; give a run's folder or its ledger.db")
    try:
        acknowledged = read_receipt(receipt_path(path))
    except LedgerError as error:
        return [str(error)]
    immutable = "" if path.with_name(path.name + "-wal").exists() else "&immutable=1"
    db = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro{immutable}", uri=True, isolation_level=None)
    try:
        return ledger_faults(db, acknowledged=acknowledged, deep=True)
    except DAMAGE as error:
        return [f"it cannot be read at all: {error}"]
    finally:
        db.close()


def ledger_faults(db: sqlite3.Connection, *, acknowledged: int | None, deep: bool) -> list[str]:
    """Everything wrong with the ledger, in words; empty where all is well.

    Args:
        acknowledged: last acknowledged batch according to the receipt; None where there is no receipt.
        deep: check indexes too (SQLite's integrity_check instead of quick_check).
    """
    version = list(_version_faults(db))
    if version:
        return version
    faults = list(_page_faults(db, deep=deep))
    for part in (_row_faults, _log_faults, _count_faults, _reference_faults):
        try:
            faults += part(db)
        except DAMAGE as error:
            faults.append(f"reading stopped: {error}")
    faults += _receipt_faults(db, acknowledged)
    return faults


def _version_faults(db: sqlite3.Connection) -> Iterator[str]:
    (application,) = db.execute("PRAGMA application_id").fetchone()
    (version,) = db.execute("PRAGMA user_version").fetchone()
    if application != APPLICATION_ID:
        yield f"it is an SQLite file, but no ledger of Tuberline (application id {application:#x})"
    elif version != SCHEMA_VERSION:
        yield (
            f"it has schema version {version}, this program knows version {SCHEMA_VERSION}: "
            "use the Tuberline that wrote it, or start a new ledger"
        )


def _page_faults(db: sqlite3.Connection, *, deep: bool) -> Iterator[str]:
    try:
        for (said,) in db.execute("PRAGMA integrity_check" if deep else "PRAGMA quick_check"):
            if said != "ok":
                yield f"damaged pages: {said}"
    except DAMAGE as error:
        yield f"damaged pages: {error}"


def _row_faults(db: sqlite3.Connection) -> Iterator[str]:
    for table in TABLES:
        bad = 0
        keys = [table.names.index(key) for key in table.key.split(", ")]
        try:
            for *columns, crc in db.execute(table.select):
                if checksum(columns) != crc:
                    bad += 1
                    if bad <= _SHOWN:
                        yield f"row of {table.name} with a wrong checksum: {[columns[at] for at in keys]}"
        except DAMAGE as error:
            yield f"table {table.name} cannot be read to its end: {error}"
        if bad > _SHOWN:
            yield f"{bad - _SHOWN} more rows of {table.name} with a wrong checksum"


def _log_faults(db: sqlite3.Connection) -> Iterator[str]:
    found = db.execute("SELECT run, camera, count(*), min(n), max(n) FROM entry GROUP BY run, camera")
    for run, camera, count, first, last in found:
        if (first, count) != (1, last):
            yield f"log of {camera} in run {run} has {count} entries between {first} and {last}: some are missing"
    (last,) = db.execute("SELECT coalesce(max(seq), 0) FROM batch").fetchone()
    (count,) = db.execute("SELECT count(*) FROM batch").fetchone()
    if last != count:
        yield f"{count} batches are there, the last is number {last}: some are missing"


def _count_faults(db: sqlite3.Connection) -> Iterator[str]:
    for (run,) in db.execute("SELECT run FROM run").fetchall():
        said = db.execute(
            "SELECT entries, tubers, observations FROM batch WHERE run = ? ORDER BY seq DESC LIMIT 1", (run,)
        ).fetchone() or (0, 0, 0)
        for table, expected in zip(("entry", "tuber", "observation"), said, strict=True):
            (count,) = db.execute(f"SELECT count(*) FROM {table} WHERE run = ?", (run,)).fetchone()
            if count != expected:
                yield f"run {run} has {count} rows of {table}, its last batch says {expected}"


def _reference_faults(db: sqlite3.Connection) -> Iterator[str]:
    questions = (
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
    for what, sql in questions:
        (count,) = db.execute(sql).fetchone()
        if count:
            yield f"{count} {what}"


def _receipt_faults(db: sqlite3.Connection, acknowledged: int | None) -> list[str]:
    try:
        (last,) = db.execute("SELECT coalesce(max(seq), 0) FROM batch").fetchone()
    except DAMAGE as error:
        return [f"the last batch cannot be read: {error}"]
    if acknowledged is None:
        return (
            [f"its receipt (.ack) is missing, so it is unknown whether all of {last} batches are there"] if last else []
        )
    if last < acknowledged:
        return [f"{acknowledged} batches were acknowledged, only {last} are there: the newest commits are lost"]
    return []
