"""Brings a ledger of an older version up to date, in one transaction of its writer.

Version 2 carries the sums of each run along (`total`) and calls a batch's watermark by its name; on the way from
version 1 (Tuberline 0.1) every row is read and verified, and a ledger that is damaged is left as it is and refused.
Version 3 adds tables for loads, empty, and version 4 columns for sizes, which hold nothing in old rows: both cost the
same whatever a ledger holds.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable

from aggregator.ledger.check import ledger_faults
from aggregator.ledger.reader import read_runs
from aggregator.ledger.recount import recount
from aggregator.ledger.schema import (
    SCHEMA_VERSION,
    TABLES,
    TOTAL,
    foreign_definition,
    load_definition,
    moving_definition,
)
from aggregator.ledger.steps import first_step
from aggregator.ledger.verified import LedgerView
from conveyor.errors import LedgerError


def migrate(db: sqlite3.Connection, view: LedgerView, step: Callable[[str], None]) -> None:
    """Bring the ledger behind `view` to this program's version; the caller begins and commits.

    Args:
        step: called with a name between the writes.

    Raises:
        LedgerError: it is damaged.
    """
    if view.version < 2:
        _to_version_2(db, view, step)
    if view.version < 3:
        for statement in load_definition():
            db.execute(statement)
            step("migration: loads' table, index or guard made")
    _to_version_4(db, view.version, step)
    db.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
    step("migration: version written")


def _to_version_2(db: sqlite3.Connection, view: LedgerView, step: Callable[[str], None]) -> None:
    faults = ledger_faults(view, acknowledged=None, receipt=False)
    if faults:
        shown = "\n".join(f"  {fault}" for fault in faults[:10])
        raise LedgerError(
            f"ledger {view.path} of version {view.version} cannot be brought to version {SCHEMA_VERSION}:\n{shown}\n"
            f"`tuberline ledger repair {view.path}` saves what is intact into a new file and keeps this one"
        )
    sums = {known.run: recount(view, known.run) for known in read_runs(view)}
    for statement in moving_definition(TOTAL):
        db.execute(statement)
        step("migration: table made")
    for run, own in sums.items():
        first_step(db, run, own)
        step("migration: sums written")
    db.execute("ALTER TABLE batch RENAME COLUMN line_x_m TO watermark_x_m")
    step("migration: column named")


def _to_version_4(db: sqlite3.Connection, version: int, step: Callable[[str], None]) -> None:
    """New columns hold nothing in old rows, which keep their checksums so."""
    for table in TABLES:
        for statement in table.additions(version):
            db.execute(statement)
            step("migration: column added")
    for statement in foreign_definition():
        db.execute(statement)
        step("migration: table of foreign matter or guard made")
