"""summary.json: what a run came to, and whether its balance sheets hold."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from aggregator.core.balance import Equation
from aggregator.core.coverage import Coverage
from aggregator.core.reasons import LoadState
from aggregator.ledger.audit import Audit, sheet
from conveyor.layers import layers_in_words
from conveyor.messages import Totals
from conveyor.messages.base import plain


def summarise(
    totals: Totals,
    *,
    line: str,
    version: str,
    other_versions: Mapping[str, str],
    audit: Audit,
    coverage: Coverage,
    counters: Mapping[str, int],
    models: Mapping[str, int],
    methods: Mapping[str, int],
    tubers: Mapping[str, int],
    belt: Mapping[str, Any],
) -> dict[str, Any]:
    """The summary as plain values.

    Args:
        version: of the aggregator; other_versions: of the nodes that ran another one last, by 'role/name'.
        audit: by the sums carried along.
        counters: of this aggregator process since it started.
        models, methods: tubers by model and by method.
        tubers: 'committed', 'merged' (seen in several tracks), 'late'.
        belt: what tubers lay on and how far below the belt plane, as the line states it.
    """
    return {
        "run": totals.run,
        "line": line,
        "software": version,
        "other_versions": dict(other_versions),
        "final": totals.final,
        "state": totals.state,
        "reason": totals.reason,
        "coverage": totals.coverage,
        "belt_m": totals.belt_m,
        "unseen_m": dict(totals.unseen_m),
        "layers": layers_in_words(totals.hidden, totals.layered_m, totals.belt_m),
        "belt": dict(belt),
        "totals": told_totals(totals),
        "balanced": audit.balanced,
        "differences": [
            f"{where}: {told(equation)}"
            for where, equations in audit.equations.items()
            for equation in equations
            if equation.difference
        ],
        "cameras": {
            camera: {
                **sheet(mark),
                "coverage": coverage.cameras.get(camera),
                "unseen_m": {why.value: metres for why, metres in coverage.unseen_m.get(camera, {}).items()},
            }
            for camera, mark in audit.marks.items()
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


_NUMBERS = ("weight_g", "low_g", "high_g", "estimated_weight_g", "estimated_low_g", "estimated_high_g", "as_weighed_g")


def told_totals(totals: Totals) -> dict[str, Any]:
    """The totals as plain values. Where nothing was seen there is no weight: null, never zero."""
    told: dict[str, Any] = plain(totals)
    if totals.load is None:  # a run in which no load is open tells what it always told
        del told["load"]
    if not totals.apart:  # one camera, or cameras that share no tubers
        del told["apart"]
    if not totals.exchanged:
        del told["exchanged"]
    if not totals.contract:
        del told["contract"], told["classes"]
    if totals.state == LoadState.NOTHING_SEEN:
        told.update(dict.fromkeys(_NUMBERS))
    return told
