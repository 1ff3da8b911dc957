"""Writes the sums of a run: the first ones with the run itself, then one step with each transaction."""

from __future__ import annotations

import sqlite3

from aggregator.ledger.schema import TOTAL, row
from aggregator.ledger.sums import RunSums


def first_step(db: sqlite3.Connection, run: str, sums: RunSums) -> None:
    """The sums of a run that has none."""
    db.execute(TOTAL.insert, row((run, 1, sums.text())))


def next_step(db: sqlite3.Connection, run: str, sums: RunSums) -> None:
    """The sums of a run after this transaction."""
    (step,) = db.execute("SELECT step FROM total WHERE run = ?", (run,)).fetchone()
    values = row((run, step + 1, sums.text()))
    db.execute("UPDATE total SET step = ?, payload = ?, crc = ? WHERE run = ?", (*values[1:], run))
