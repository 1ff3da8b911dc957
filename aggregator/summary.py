"""summary.json: what a run came to, and whether its balance sheets hold."""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping
from typing import Any

from aggregator.core.balance import Equation
from aggregator.ledger.audit import Audit, sheet
from conveyor.messages import Totals
from conveyor.messages.base import plain


def summarise(
    totals: Totals,
    *,
    line: str,
    version: str,
    audit: Audit,
    camera_coverage: Mapping[str, float | None],
    counters: Mapping[str, int],
    models: Mapping[str, int],
    methods: Mapping[str, int],
    tubers: Mapping[str, int],
) -> dict[str, Any]:
    """The summary as plain values.

    Args:
        counters: of this aggregator process since it started.
        models, methods: tubers by model and by method.
        tubers: 'committed', 'merged' (seen in several tracks), 'late'.
    """
    return {
        "run": totals.run,
        "line": line,
        "software": version,
        "final": totals.final,
        "totals": plain(totals),
        "balanced": audit.balanced,
        "differences": [
            f"{where}: {told(equation)}"
            for where, equations in audit.equations.items()
            for equation in equations
            if equation.difference
        ],
        "cameras": {
            camera: {**sheet(mark), "coverage": camera_coverage.get(camera)} for camera, mark in audit.marks.items()
        },
        "tubers": dict(tubers),
        "tracks": dict(audit.tracks),
        "set_aside": dict(audit.set_aside),
        "methods": dict(sorted(methods.items())),
        "models": dict(sorted(models.items())),
        "aggregator": dict(sorted(counters.items())),
    }


def told(equation: Equation) -> str:
    """An equation that does not hold, in words."""
    return f"{equation.text} does not hold: {equation.left} is not {equation.right} ({equation.difference:+d})"


def tally(db: sqlite3.Connection, run: str) -> tuple[dict[str, int], dict[str, int]]:
    """(tubers by model, tubers by method); those without a weighed view count under the method alone."""
    models = dict(db.execute("SELECT model, count(*) FROM tuber WHERE run = ? AND model != '' GROUP BY model", (run,)))
    return models, dict(db.execute("SELECT method, count(*) FROM tuber WHERE run = ? GROUP BY method", (run,)))
