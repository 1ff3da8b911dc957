"""Writes the sums of a run, and of stretches of its belt: the first ones, then one step with each transaction."""

from __future__ import annotations

import sqlite3

from aggregator.ledger.load_rows import SpanSums
from aggregator.ledger.schema import LOAD_TOTAL, TOTAL, row
from aggregator.ledger.sums import RunSums


def first_step(db: sqlite3.Connection, run: str, sums: RunSums) -> None:
    """The sums of a run that has none."""
    db.execute(TOTAL.insert, row((run, 1, sums.text())))


def next_step(db: sqlite3.Connection, run: str, sums: RunSums) -> None:
    """The sums of a run after this transaction."""
    (step,) = db.execute("SELECT step FROM total WHERE run = ?", (run,)).fetchone()
    values = row((run, step + 1, sums.text()))
    db.execute("UPDATE total SET step = ?, payload = ?, crc = ? WHERE run = ?", (*values[1:], run))


def span_step(db: sqlite3.Connection, run: str, span: int, sums: SpanSums) -> None:
    """The sums of a stretch after this transaction, the first ones or the next."""
    found = db.execute("SELECT step FROM load_total WHERE run = ? AND span = ?", (run, span)).fetchone()
    values = row((run, span, found[0] + 1 if found else 1, sums.text()))
    if found is None:
        db.execute(LOAD_TOTAL.insert, values)
    else:
        change = "UPDATE load_total SET step = ?, payload = ?, crc = ? WHERE run = ? AND span = ?"
        db.execute(change, (*values[2:], run, span))
