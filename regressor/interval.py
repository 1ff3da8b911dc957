"""Honest intervals: conformal calibration of a view's weight on views the network never saw.

Split conformal prediction, per class of the predicted weight: the 5 % and 95 % quantiles of truth minus prediction on
the calibration set (with the finite-sample correction) are added to a prediction; between the classes' centres they
are interpolated, so that the interval does not jump.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

LEVEL = 0.9
EDGES_G = (0.0, 50.0, 100.0, 150.0, 200.0, 250.0, 300.0, 400.0, np.inf)
MIN_IN_CLASS = 40


@dataclass(frozen=True, slots=True)
class IntervalRule:
    """Grams to add to a prediction for the two ends of its interval, at predictions `at_g` (rising)."""

    level: float
    at_g: tuple[float, ...]
    below_g: tuple[float, ...]
    above_g: tuple[float, ...]
    views: int

    def bounds_g(self, predicted_g: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(low, high), each (n,) grams, for (n,) predictions; never below zero and never on the wrong side."""
        below = np.interp(predicted_g, self.at_g, self.below_g)
        above = np.interp(predicted_g, self.at_g, self.above_g)
        low = np.maximum(np.minimum(predicted_g + below, predicted_g), 0.0)
        return low, np.maximum(predicted_g + above, predicted_g)

    def to_json(self) -> dict[str, Any]:
        """For the sidecar of a checkpoint."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> IntervalRule:
        """From the sidecar of a checkpoint."""
        values = {name: tuple(float(v) for v in data[name]) for name in ("at_g", "below_g", "above_g")}
        return cls(level=float(data["level"]), views=int(data["views"]), **values)


def calibrate(predicted_g: NDArray[np.float64], weight_g: NDArray[np.float64], *, level: float = LEVEL) -> IntervalRule:
    """The rule that covers `level` of the calibration views in each class with at least 40 of them.

    Args:
        predicted_g, weight_g: (n,) of views of tubers that were not trained on.
    """
    residual = weight_g - predicted_g
    at, below, above = [], [], []
    for begin, end in pairwise(EDGES_G):
        inside = (predicted_g >= begin) & (predicted_g < end)
        if inside.sum() < MIN_IN_CLASS:
            continue
        low, high = _quantiles(residual[inside], level)
        at.append(float(np.median(predicted_g[inside])))
        below.append(low)
        above.append(high)
    if not at:
        low, high = _quantiles(residual, level)
        at, below, above = [float(np.median(predicted_g))], [low], [high]
    return IntervalRule(level, tuple(at), tuple(below), tuple(above), len(residual))


def _quantiles(residual: NDArray[np.float64], level: float) -> tuple[float, float]:
    count = len(residual)
    # Each tail takes half of what may be missed; the +1 makes the promise hold for a new view, not for these.
    share = min(1.0, np.ceil((count + 1) * (1 + level) / 2) / count)
    return float(-np.quantile(-residual, share)), float(np.quantile(residual, share))


def shared_share(residual: NDArray[np.float64], tuber: NDArray[np.str_]) -> float:
    """Standard deviation of the error that a tuber's views share, as a share of a view's whole error's, 0..1.

    One-way random effects: the mean square between tubers minus the one within them. Fusing n views leaves
    `sd * sqrt(share^2 + (1 - share^2) / n)`, not `sd / sqrt(n)`.
    """
    _, owner, count = np.unique(tuber, return_inverse=True, return_counts=True)
    several = (count > 1)[owner]
    owner, residual = np.unique(owner[several], return_inverse=True)[1], residual[several]
    count = np.bincount(owner)
    groups, total = len(count), len(residual)
    if groups < 2 or total <= groups:
        return 1.0
    mean = np.bincount(owner, weights=residual) / count
    within = float(((residual - mean[owner]) ** 2).sum() / (total - groups))
    between = float((count * (mean - residual.mean()) ** 2).sum() / (groups - 1))
    size = (total - (count**2).sum() / total) / (groups - 1)
    shared = max(0.0, (between - within) / size)
    return float(np.sqrt(shared / (shared + within)))
