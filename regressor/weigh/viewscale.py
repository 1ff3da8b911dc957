"""How far off a weight may be, from what its view shows: the scale of an interval.

A gamma regression with a log link of |truth - weight| on five things a view tells of itself: the weight, its square,
how far network and volume rule disagree, how elongated the outline is, and how high the tuber stands for its width
(upright and tumbling tubers hide more). Few and smooth, clipped to what the calibration saw, so that a strange view
gets a wide interval and never an absurd one. What no view shows is how well the belt's height is known: the line says
so (`segmenter.belt_sd_mm`), and the sixth term is how much of the visible volume that makes uncertain.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from regressor.weigh.quadratic import within
from regressor.weigh.rule_json import number, numbers
from regressor.weigh.surface import NAMES

TERMS = ("ln_weight", "ln_weight_squared", "disagreement", "elongation", "steepness", "belt")
TYPICAL_G = 150.0
OWN_ERROR = 0.05
"""Of the weight: about what a view is off by over a belt whose height is known exactly."""
BELT, MOST_BELT = TERMS.index("belt"), 3.0
TYPICAL_SLOPES = (0.9, 0.1, 1.2, 0.2, 0.4, 0.84)
"""Of the shipped weights over a good camera, in the order of `TERMS`: what is expected before much was seen. That of
the belt is the only one there is where all views of a calibration know their belt equally well: the term follows area
and volume alone then, and says nothing of belts that are known better or worse. 1 would be the whole of the volume that
the belt makes uncertain, beside an error of 5 %; a weight moves a little less."""
RIDGE = 1.0
ROUNDS = 50
CLIP_SHARE = 0.005
MAX_RATIO = 100.0


def beyond(distance_m: NDArray[np.float64] | float, farthest_m: float | None, power: float) -> NDArray[np.float64]:
    """What errors of views (n,) metres from the belt are multiplied by: 1 as far as was fitted, then a power of it.

    `farthest_m`: None where it was not noted; nothing grows then.
    """
    wider: NDArray[np.float64] = np.maximum(np.asarray(distance_m) / (farthest_m or np.inf), 1.0) ** power
    return wider


def view_terms(
    weight_g: NDArray[np.float64],
    network_g: NDArray[np.float64],
    volume_g: NDArray[np.float64],
    features: NDArray[np.float64],
    height_m: NDArray[np.float64],
    belt_sd_m: NDArray[np.float64],
) -> NDArray[np.float64]:
    """(n, 6) what n views show and the line knows, in the order of `TERMS`.

    Args:
        weight_g, network_g, volume_g: (n,) the blended weight and its two parts.
        features: (n, 5 or more) of the visible surface as in `surface.NAMES`.
        height_m: (n,) above the resting level, not clamped.
        belt_sd_m: (n,) how well the resting level is known, standard deviation: the belt's height and the offset.
    """
    length_mm, width_mm = (np.maximum(features[:, NAMES.index(name)], 1.0) for name in ("length_mm", "width_mm"))
    ln_weight = np.log(np.maximum(weight_g, 1.0) / TYPICAL_G)
    disagreement = np.abs(np.log(np.maximum(network_g, 1.0) / np.maximum(volume_g, 1.0)))
    steepness = np.log(np.maximum(1e3 * height_m, 5.0) / width_mm)
    volume_ml, area_cm2 = (np.maximum(features[:, NAMES.index(name)], 1.0) for name in ("volume_ml", "area_cm2"))
    # A belt that lies d higher takes d * area from the visible volume.
    belt = np.log(np.hypot(1.0, 100 * belt_sd_m * area_cm2 / volume_ml / OWN_ERROR))
    return np.column_stack([ln_weight, ln_weight**2, disagreement, np.log(length_mm / width_mm), steepness, belt])


@dataclass(frozen=True)
class ScaleRule:
    """ln scale = intercept + sum(slopes * (terms clipped to low..high)); scales are in grams."""

    intercept: float
    slopes: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]

    def scale_g(self, terms: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) grams of (n, 6) `view_terms`."""
        low, high, slopes = self._arrays
        scale: NDArray[np.float64] = np.exp(self.intercept + within(terms, low, high) @ slopes)
        return scale

    @cached_property
    def _arrays(self) -> tuple[NDArray[np.float64], ...]:
        return tuple(np.array(values) for values in (self.low, self.high, self.slopes))

    def to_json(self) -> dict[str, Any]:
        """For the sidecar of a checkpoint."""
        return {"terms": TERMS, **asdict(self)}

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> ScaleRule:
        """From the sidecar of a checkpoint.

        Raises:
            ValueError: made from other terms than this code knows, or of numbers that it cannot hold.
        """
        terms = tuple(data["terms"])
        if terms not in (TERMS, TERMS[:BELT]):
            raise ValueError(f"an interval's scale is made from {data['terms']}; known: {TERMS}")
        # Sidecars from before the belt was a term: it has no say there.
        rest = (0.0,) * (len(TERMS) - len(terms))
        low, high, slopes = (numbers(data, name, len(terms)) + rest for name in ("low", "high", "slopes"))
        return cls(number(data, "intercept"), slopes, low, high)


def fit_scale(
    terms: NDArray[np.float64],
    residual_g: NDArray[np.float64],
    *,
    share: NDArray[np.float64] | None = None,
    prior: tuple[float, ...] = (0.0,) * len(TERMS),
    ridge: float = RIDGE,
    belt_slope: float | None = None,
) -> ScaleRule:
    """The scale that (n, 6) `terms` say of (n,) residuals: gamma likelihood, log link, by Newton steps.

    A belt that is known worse never makes it smaller: the slope over it is at least 0.

    Args:
        share: (n,) what each row counts for; 1 where it is not given. prior: the slopes that `ridge` draws towards.
        belt_slope: the slope over the belt; fitted where it is not given.
    """
    low, high = np.quantile(terms, [CLIP_SHARE, 1 - CLIP_SHARE], axis=0)
    # The weight itself is not clipped: the largest tubers are few, and their errors are the largest. Nor is the belt:
    # one that is known worse than any calibration saw makes intervals wider still.
    low[:2], high[:2] = terms[:, :2].min(0), terms[:, :2].max(0)
    low[BELT], high[BELT] = 0.0, MOST_BELT
    intercept, slopes = _fitted(np.clip(terms, low, high), np.abs(residual_g), share, prior, ridge, belt_slope)
    if slopes[BELT] < 0:
        intercept, slopes = _fitted(np.clip(terms, low, high), np.abs(residual_g), share, prior, ridge, 0.0)
    return ScaleRule(
        intercept=intercept,
        slopes=tuple(float(value) for value in slopes),
        low=tuple(float(value) for value in low),
        high=tuple(float(value) for value in high),
    )


def _fitted(
    clipped: NDArray[np.float64],
    size: NDArray[np.float64],
    share: NDArray[np.float64] | None,
    prior: tuple[float, ...],
    ridge: float,
    belt_slope: float | None,
) -> tuple[float, NDArray[np.float64]]:
    """(intercept, (6,) slopes); that over the belt is `belt_slope` where one is given."""
    weight = np.ones(len(size)) if share is None else share
    centre, spread = clipped.mean(0), np.maximum(clipped.std(0), 1e-6)
    columns = (clipped - centre) / spread
    known = np.zeros(len(size))
    expected = np.array([0.0, *(prior * spread)])
    if belt_slope is not None:
        known, columns[:, BELT], expected[1 + BELT] = belt_slope * (clipped[:, BELT] - centre[BELT]), 0.0, 0.0
    design = np.column_stack([np.ones(len(size)), columns])
    beta = expected.copy()
    beta[0] = np.log(max(float(np.average(size, weights=weight)), 1e-3))
    penalty = ridge * np.diag([0.0] + [1.0] * len(TERMS))
    for _ in range(ROUNDS):
        ratio = np.minimum(size / np.exp(known + design @ beta), MAX_RATIO)
        gradient = design.T @ (weight * (ratio - 1)) - penalty @ (beta - expected)
        step = np.linalg.solve((design * (weight * ratio)[:, None]).T @ design + penalty, gradient)
        # A whole Newton step may overshoot far from the optimum; half a unit in ln is plenty.
        beta += np.clip(step, -0.5, 0.5)
        if float(np.abs(step).max()) < 1e-9:
            break
    slopes = beta[1:] / spread
    if belt_slope is not None:
        slopes[BELT] = belt_slope
    return float(beta[0] - centre @ slopes), slopes
