"""The last loads of a ledger: one line each, for who asks over the link."""

from __future__ import annotations

import json
from typing import Any

from aggregator.ledger.ends import end_of
from aggregator.ledger.reader import RunRow, read_runs, read_summary, read_sums, run_being_written
from aggregator.ledger.verified import LedgerView


def last_loads(view: LedgerView, *, limit: int) -> list[dict[str, Any]]:
    """Runs of a ledger, the newest first: when begun, what they came to, and how they ended (`ends.End`).

    A run without a summary (it goes on, was stopped, or its process was killed) is told by its sums: no interval then,
    and no coverage.
    """
    newest, written = read_runs(view)[::-1][:limit], run_being_written(view)
    return [
        {
            "run": known.run,
            "started_unix_s": known.started_ns / 1e9,
            "end": end_of(view, known, written),
            **_came_to(view, known),
        }
        for known in newest
    ]


def _came_to(view: LedgerView, known: RunRow) -> dict[str, Any]:
    summary = read_summary(view, known.run)
    if summary is not None:
        totals = json.loads(summary)["totals"]
        return {name: totals[name] for name in ("count", "weight_g", "low_g", "high_g", "coverage", "final")}
    load = read_sums(view, known.run).load
    nothing = {"low_g": None, "high_g": None, "coverage": None, "final": False}
    return {"count": load.count, "weight_g": load.as_weighed_g, **nothing}
