"""Honest intervals: conformal calibration of a view's weight on views the network never saw.

Split conformal prediction on normalised residuals: truth minus prediction, divided by the scale that the view itself
suggests (`regressor.weigh.viewscale`). Their 5 % and 95 % quantiles per class of the predicted weight (with the
finite-sample correction) times the scale are added to a prediction; between the classes' centres they are
interpolated, so that the interval does not jump. Sidecars made before there was a scale hold grams: their scale is 1.

A view of a belt farther away than any that was calibrated has an interval wider than those: `beyond`.

Views of cameras unlike good ones (`regressor.weigh.unlike`) have scale and quantiles of
their own. Which camera took a view is known with a chance only; the interval lies between the two by that chance.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from regressor.weigh.rule_json import number, numbers
from regressor.weigh.unlike import CameraRule, fit_camera
from regressor.weigh.viewscale import ScaleRule, beyond, fit_scale

LEVEL = 0.9
EDGES_G = (0.0, 50.0, 100.0, 150.0, 200.0, 250.0, 300.0, 400.0, np.inf)
MIN_IN_CLASS = 40
FARTHER = 1.5
"""Errors of views beyond the distances of the calibration grow with so high a power of the distance: by 1.5 before a
camera of `easy`, 1.2 to 1.4 before one of `field`, from 0.56 to 0.75, 0.9 and 1.1 m (packs of seed 8111)."""
ROUNDS, WIDEST = 6, 0.06
"""Of `calibrate_cameras`, and by how much its level for other cameras may be over the one that is asked for."""


@dataclass(frozen=True, slots=True)
class IntervalRule:
    """Multiples of a view's scale (grams, where there is none) from a prediction to the two ends of its interval.

    Attributes:
        at_g: the predictions, rising, at which `below_g` and `above_g` hold.
        camera, other: how likely the view is of a camera unlike a good one, and the interval that it has then;
            None where only one kind of camera was calibrated.
        farthest_m: distance to the belt of the farthest views of the calibration; None where it was not noted.
    """

    level: float
    at_g: tuple[float, ...]
    below_g: tuple[float, ...]
    above_g: tuple[float, ...]
    views: int
    scale: ScaleRule | None = None
    camera: CameraRule | None = None
    other: IntervalRule | None = None
    farthest_m: float | None = None

    def unlike(self, noise_px: NDArray[np.float64], features: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) chance that a camera unlike a good one took each view; arguments of `unlike.camera_terms`."""
        return self.camera.chance(noise_px, features) if self.camera else np.zeros(len(features))

    def bounds_g(
        self,
        predicted_g: NDArray[np.float64],
        terms: NDArray[np.float64],
        unlike: NDArray[np.float64] | float = 0.0,
        distance_m: NDArray[np.float64] | float = 0.0,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(low, high), each (n,) grams, for (n,) predictions; never below zero and never on the wrong side.

        Args:
            terms: (n, 6) of `viewscale.view_terms`. unlike: (n,) as `unlike` has it. distance_m: (n,) to the belt.
        """
        below, above = self._reach_g(predicted_g, terms)
        if self.other is not None:
            others = self.other._reach_g(predicted_g, terms)
            below, above = below + unlike * (others[0] - below), above + unlike * (others[1] - above)
        wider = self.beyond(distance_m)
        return np.maximum(predicted_g + wider * below, 0.0), predicted_g + wider * above

    def beyond(self, distance_m: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """What the intervals of views (n,) metres from the belt are multiplied by: 1 as far as was calibrated."""
        return beyond(distance_m, self.farthest_m, FARTHER)

    def _reach_g(
        self, predicted_g: NDArray[np.float64], terms: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """((n,) at most 0, (n,) at least 0) grams from each prediction to its bounds."""
        scale = 1.0 if self.scale is None else self.scale.scale_g(terms)
        below = scale * np.interp(predicted_g, self.at_g, self.below_g)
        above = scale * np.interp(predicted_g, self.at_g, self.above_g)
        return np.minimum(below, 0.0), np.maximum(above, 0.0)

    def to_json(self) -> dict[str, Any]:
        """For the sidecar of a checkpoint; of cameras only where there are two kinds."""
        told = {**asdict(self), "scale": self.scale.to_json() if self.scale else None}
        del told["camera"], told["other"]
        if self.farthest_m is None:
            del told["farthest_m"]
        if self.camera and self.other:
            told |= {"camera": self.camera.to_json(), "other": self.other.to_json()}
        return told

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> IntervalRule:
        """From the sidecar of a checkpoint.

        Raises:
            ValueError: it is of another version, or holds numbers that it cannot.
        """
        at_g = numbers(data, "at_g")
        if not at_g or sorted(at_g) != list(at_g):
            raise ValueError(f"at_g is {at_g}, not one or more weights that rise")
        below_g, above_g = (numbers(data, name, len(at_g)) for name in ("below_g", "above_g"))
        scale = ScaleRule.from_json(data["scale"]) if data.get("scale") else None
        camera = CameraRule.from_json(data["camera"]) if data.get("camera") else None
        other = cls.from_json(data["other"]) if data.get("other") else None
        views = int(number(data, "views"))
        farthest_m = number(data, "farthest_m") if data.get("farthest_m") else None
        return cls(number(data, "level"), at_g, below_g, above_g, views, scale, camera, other, farthest_m)


def calibrate(
    predicted_g: NDArray[np.float64],
    weight_g: NDArray[np.float64],
    terms: NDArray[np.float64],
    *,
    level: float = LEVEL,
    independent: int | None = None,
    tuber: NDArray[np.str_] | None = None,
    belt_slope: float | None = None,
) -> IntervalRule:
    """The rule that covers `level` of the calibration views in each class with at least 40 tubers.

    Args:
        predicted_g, weight_g: (n,) of views of tubers that were not trained on. terms: (n, 6) of `view_terms`.
        independent: how many recordings they are from: views of one share belt, camera and cultivar, so that the
            promise for a view of a new recording needs the finite-sample correction of their number. Where recordings
            are not known, tubers are what is independent: `regressor.training.tuber_interval`.
        tuber: (n,) whose view each is; every view is of another tuber where it is not given.
        belt_slope: as for `fit_scale`.
    """
    scale = fit_scale(terms, weight_g - predicted_g, belt_slope=belt_slope)
    residual = (weight_g - predicted_g) / scale.scale_g(terms)
    at, below, above = [], [], []
    for begin, end in pairwise(EDGES_G):
        inside = (predicted_g >= begin) & (predicted_g < end)
        if (inside.sum() if tuber is None else len(np.unique(tuber[inside]))) < MIN_IN_CLASS:
            continue
        low, high = _quantiles(residual[inside], level, independent)
        at.append(float(np.median(predicted_g[inside])))
        below.append(low)
        above.append(high)
    if not at:
        low, high = _quantiles(residual, level, independent)
        at, below, above = [float(np.median(predicted_g))], [low], [high]
    return IntervalRule(level, tuple(at), tuple(below), tuple(above), len(residual), scale)


def calibrate_cameras(
    predicted_g: NDArray[np.float64],
    weight_g: NDArray[np.float64],
    terms: NDArray[np.float64],
    *,
    noise_px: NDArray[np.float64],
    features: NDArray[np.float64],
    unlike: NDArray[np.bool_],
    recording: NDArray[np.str_],
    tuber: NDArray[np.str_] | None = None,
    level: float = LEVEL,
    belt_slope: float | None = None,
) -> IntervalRule:
    """The rule that covers `level` of the views of good cameras, and of those of all others; of all of them together
    where too few views tell which camera took them.

    Some views of the others look like those of good ones: their intervals are too narrow. So the ones that are
    recognised are given a higher level, the least with which the others hold as a whole. Good cameras keep the
    level that is asked for, though a few of their views get the others' width.

    Args:
        predicted_g, weight_g, terms, tuber, level, belt_slope: as for `calibrate`.
        noise_px, features: as for `unlike.camera_terms`.
        unlike: (n,) which views poor cameras took. recording: (n,) of each view.
    """
    camera = fit_camera(noise_px, features, unlike)
    chance = camera.chance(noise_px, features)
    told = ~unlike & (chance <= 0.5), unlike & (chance > 0.5)

    def of(rows: NDArray[np.bool_], level: float) -> IntervalRule:
        return calibrate(
            predicted_g[rows],
            weight_g[rows],
            terms[rows],
            level=level,
            independent=len(np.unique(recording[rows])),
            tuber=None if tuber is None else tuber[rows],
            belt_slope=belt_slope,
        )

    if min(int(rows.sum()) for rows in told) < MIN_IN_CLASS:
        return of(np.ones(len(unlike), np.bool_), level)
    levels = [level, level]
    for _ in range(ROUNDS):
        kinds = [of(rows, at) for rows, at in zip(told, levels, strict=True)]
        rule = replace(kinds[0], level=level, camera=camera, other=replace(kinds[1], level=level))
        low, high = rule.bounds_g(predicted_g, terms, chance)
        held = ((weight_g >= low) & (weight_g <= high))[unlike].mean()
        levels[1] = float(np.clip(levels[1] + level - held, level, level + WIDEST))
    return rule


def _quantiles(residual: NDArray[np.float64], level: float, independent: int | None) -> tuple[float, float]:
    count = min(len(residual), independent or len(residual))
    # Each tail takes half of what may be missed; the +1 makes the promise hold for a new view, not for these.
    share = min(1.0, np.ceil((count + 1) * (1 + level) / 2) / count)
    return float(-np.quantile(-residual, share)), float(np.quantile(residual, share))
