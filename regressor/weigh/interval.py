"""Honest intervals: conformal calibration of a view's weight on views the network never saw.

Split conformal prediction on normalised residuals: truth minus prediction, divided by the scale that the view itself
suggests (`regressor.weigh.viewscale`). Their 5 % and 95 % quantiles per class of the predicted weight (with the
finite-sample correction) times the scale are added to a prediction; between the classes' centres they are
interpolated, so that the interval does not jump. Sidecars made before there was a scale hold grams: their scale is 1.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from regressor.weigh.viewscale import ScaleRule, fit_scale

LEVEL = 0.9
EDGES_G = (0.0, 50.0, 100.0, 150.0, 200.0, 250.0, 300.0, 400.0, np.inf)
MIN_IN_CLASS = 40


@dataclass(frozen=True, slots=True)
class IntervalRule:
    """Multiples of a view's scale (grams, where there is none) from a prediction to the two ends of its interval.

    `at_g`: the predictions, rising, at which `below` and `above` hold.
    """

    level: float
    at_g: tuple[float, ...]
    below_g: tuple[float, ...]
    above_g: tuple[float, ...]
    views: int
    scale: ScaleRule | None = None

    def bounds_g(
        self, predicted_g: NDArray[np.float64], terms: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(low, high), each (n,) grams, for (n,) predictions; never below zero and never on the wrong side.

        Args:
            terms: (n, 6) of `viewscale.view_terms`.
        """
        scale = 1.0 if self.scale is None else self.scale.scale_g(terms)
        below = scale * np.interp(predicted_g, self.at_g, self.below_g)
        above = scale * np.interp(predicted_g, self.at_g, self.above_g)
        low = np.maximum(np.minimum(predicted_g + below, predicted_g), 0.0)
        return low, np.maximum(predicted_g + above, predicted_g)

    def to_json(self) -> dict[str, Any]:
        """For the sidecar of a checkpoint."""
        return {**asdict(self), "scale": self.scale.to_json() if self.scale else None}

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> IntervalRule:
        """From the sidecar of a checkpoint."""
        values = {name: tuple(float(v) for v in data[name]) for name in ("at_g", "below_g", "above_g")}
        scale = ScaleRule.from_json(data["scale"]) if data.get("scale") else None
        return cls(level=float(data["level"]), views=int(data["views"]), scale=scale, **values)


def calibrate(
    predicted_g: NDArray[np.float64],
    weight_g: NDArray[np.float64],
    terms: NDArray[np.float64],
    *,
    level: float = LEVEL,
    independent: int | None = None,
) -> IntervalRule:
    """The rule that covers `level` of the calibration views in each class with at least 40 of them.

    Args:
        predicted_g, weight_g: (n,) of views of tubers that were not trained on. terms: (n, 6) of `view_terms`.
        independent: how many recordings they are from: views of one share belt, camera and cultivar, so that the
            promise for a view of a new recording needs the finite-sample correction of their number.
    """
    scale = fit_scale(terms, weight_g - predicted_g)
    residual = (weight_g - predicted_g) / scale.scale_g(terms)
    at, below, above = [], [], []
    for begin, end in pairwise(EDGES_G):
        inside = (predicted_g >= begin) & (predicted_g < end)
        if inside.sum() < MIN_IN_CLASS:
            continue
        low, high = _quantiles(residual[inside], level, independent)
        at.append(float(np.median(predicted_g[inside])))
        below.append(low)
        above.append(high)
    if not at:
        low, high = _quantiles(residual, level, independent)
        at, below, above = [float(np.median(predicted_g))], [low], [high]
    return IntervalRule(level, tuple(at), tuple(below), tuple(above), len(residual), scale)


def _quantiles(residual: NDArray[np.float64], level: float, independent: int | None) -> tuple[float, float]:
    count = min(len(residual), independent or len(residual))
    # Each tail takes half of what may be missed; the +1 makes the promise hold for a new view, not for these.
    share = min(1.0, np.ceil((count + 1) * (1 + level) / 2) / count)
    return float(-np.quantile(-residual, share)), float(np.quantile(residual, share))
