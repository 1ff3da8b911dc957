"""The last loads of a ledger: one line each, for who asks over the link."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from aggregator.ledger.ends import end_of
from aggregator.ledger.reader import RunRow, read_runs, read_sums, run_being_written
from aggregator.ledger.stated import summary_told
from aggregator.ledger.sums import RunSums
from aggregator.ledger.verified import LedgerView


def last_loads(view: LedgerView, *, limit: int) -> list[dict[str, Any]]:
    """Runs of a ledger, the newest first: when begun, what they came to, and how they ended (`ends.End`).

    A run without a summary (it goes on, was stopped, or its process was killed) is told by its sums: no interval then,
    and no coverage.
    """
    newest, written = read_runs(view)[::-1][:limit], run_being_written(view)
    found = []
    for known in newest:
        sums = read_sums(view, known.run)
        summary = summary_told(view, known.run, sums)
        end = end_of(known, written, sums=sums, summary=summary)
        begun = {"run": known.run, "started_unix_s": known.started_ns / 1e9}
        found.append({**begun, "end": end, **_came_to(known, sums, summary)})
    return found


def _came_to(known: RunRow, sums: RunSums, summary: Mapping[str, Any]) -> dict[str, Any]:
    if known.finished:
        totals = summary["totals"]
        return {name: totals[name] for name in ("count", "weight_g", "low_g", "high_g", "coverage", "final")}
    nothing = {"low_g": None, "high_g": None, "coverage": None, "final": False}
    return {"count": sums.load.count, "weight_g": sums.load.as_weighed_g, **nothing}
