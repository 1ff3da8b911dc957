"""The last loads of a ledger: one line each, for who asks over the link."""

from __future__ import annotations

import json
import sqlite3
from typing import Any


def last_loads(db: sqlite3.Connection, *, limit: int) -> list[dict[str, Any]]:
    """Runs of a ledger, the newest first: when begun, what they came to, whether they ended.

    A run without a summary (it goes on, or its process was killed) is added up from its tubers: no interval then, and
    no coverage.
    """
    found = db.execute(
        "SELECT run.run, started_ns, summary.payload FROM run LEFT JOIN summary USING (run) "
        "ORDER BY started_ns DESC, run.run DESC LIMIT ?",
        (limit,),
    ).fetchall()
    return [
        _ended(run, started_ns, payload) if payload else _open(db, run, started_ns)
        for run, started_ns, payload in found
    ]


def _ended(run: str, started_ns: int, payload: str) -> dict[str, Any]:
    totals = json.loads(payload)["totals"]
    kept = ("count", "weight_g", "low_g", "high_g", "coverage", "final")
    return {"run": run, "started_unix_s": started_ns / 1e9, **{name: totals[name] for name in kept}}


def _open(db: sqlite3.Connection, run: str, started_ns: int) -> dict[str, Any]:
    count, weight_g = db.execute(
        "SELECT count(*), coalesce(sum(weight_g), 0.0) FROM tuber WHERE run = ?", (run,)
    ).fetchone()
    nothing = {"low_g": None, "high_g": None, "coverage": None, "final": False}
    return {"run": run, "started_unix_s": started_ns / 1e9, "count": count, "weight_g": weight_g, **nothing}
