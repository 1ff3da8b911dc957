"""Do the cameras of a run count their travel from one zero? By what each told at the same time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from aggregator.ledger.schema import COVERAGE
from aggregator.ledger.verified import LedgerView
from conveyor.messages import CamerasApart

LEAST_M = 0.1
"""Less is a clock that runs 0.3 s ahead of another, or a tuber's own place; `aggregator.ledger.apart` tells that."""
STEADY = 0.1
"""Of the difference: travels that drift apart by more have another cause than their zeros."""
TIMES = 50
"""At which two cameras are compared."""

Curve = NDArray[np.float64]


def zeros_told(view: LedgerView, run: str, cameras: Sequence[str], apart: Iterable[CamerasApart]) -> list[str]:
    """In words, whose travel is beyond that of the first camera to which an encoder, or a recording, tells it.

    Args:
        apart: what the tubers say: of cameras that they lay side by side only the clocks differ.
    """
    agree = {(pair.first, pair.second) for pair in apart if not pair.alarm}
    told = {camera: curve for camera in sorted(cameras) if len(curve := _curve(view, run, camera))}
    first, *others = told or [""]
    found = {camera: _beyond_m(told[first], told[camera]) for camera in others if (first, camera) not in agree}
    return [
        f"camera '{camera}' tells {abs(beyond_m):.2f} m {'more' if beyond_m > 0 else 'less'} travel than camera "
        f"'{first}' at the same time: unless their clocks differ, the two count from different zeros; then tubers that "
        "both see count twice, and belt counts as not seen. Give travel_m of both from one zero, or leave it out: of "
        "cameras with one clock the load tells it"
        for camera, beyond_m in found.items()
        if beyond_m is not None
    ]


def _curve(view: LedgerView, run: str, camera: str) -> Curve:
    """(n, 2) capture time in seconds and travel in metres of a camera's marks; empty where the load told it."""
    rows = list(view.rows(COVERAGE, "WHERE run = ? AND camera = ? ORDER BY n", (run, camera)))
    estimated = any(row[COVERAGE.names.index("travel_estimated")] for row in rows)
    columns = [COVERAGE.names.index(name) for name in ("captured_ns", "travel_m")]
    return np.array([[row[n] for n in columns] for row in rows if not estimated], float).reshape(-1, 2) * (1e-9, 1)


def _beyond_m(first: Curve, second: Curve) -> float | None:
    """By how much the second travel is steadily more than the first; None where it is not, or no time is common."""
    begin_s, end_s = max(first[0, 0], second[0, 0]), min(first[-1, 0], second[-1, 0])
    if begin_s >= end_s:
        return None
    at_s = np.linspace(begin_s, end_s, TIMES)
    more_m = np.interp(at_s, *second.T) - np.interp(at_s, *first.T)
    beyond_m = float(np.median(more_m))
    steady = np.abs(more_m - beyond_m) <= STEADY * abs(beyond_m)
    return beyond_m if abs(beyond_m) > LEAST_M and steady.mean() > 1 - STEADY else None
