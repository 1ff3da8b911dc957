"""Intervals where nothing says which views belong to one recording: what is independent then is the tubers.

Views of a tuber share most of their error: twenty tubers with thirty views each are little more than twenty draws. So
every tuber counts alike, however many views it has, and an interval is chosen so that it holds its level in
`CONFIDENCE` of all calibrations with as many tubers. The scale is fitted on the same few, whose residuals over it are
too small: each tuber's are taken over a scale that was fitted without it.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, ndtri

from conveyor.small_sample import holding_rank
from regressor.weigh.interval import EDGES_G, LEVEL, MIN_IN_CLASS, IntervalRule
from regressor.weigh.viewscale import TYPICAL_SLOPES, ScaleRule, fit_scale

CONFIDENCE = 0.9
"""Of a calibration that holds its level: as for tickets of single tubers."""
MIN_TUBERS = MIN_IN_CLASS
"""With fewer a calibration is told to be a poor one."""
SEEN_TAILS = 100
"""With fewer tubers quantiles that hold their level so often are the largest errors, and wider than need be. Errors are
taken for normal then, and their spread for the largest that so few tubers leave likely. On views of simulated tubers,
calibrated on 40 of them: 25 % of a weight wide instead of 36 %, and held as often."""
FOLDS = 10
SHRINK = 10.0
"""How many tubers the slopes of the shipped weights (`TYPICAL_SLOPES`) count for beside those that are there."""


def calibrate_tubers(
    predicted_g: NDArray[np.float64],
    weight_g: NDArray[np.float64],
    terms: NDArray[np.float64],
    tuber: NDArray[np.str_],
    *,
    level: float = LEVEL,
    belt_slope: float | None = None,
) -> IntervalRule:
    """The rule that covers `level` of the views of other tubers, in 9 of 10 such calibrations.

    In each class of the predicted weight with at least `SEEN_TAILS` tubers; over all views where no class has as many.

    Args:
        predicted_g, weight_g: (n,) of views of tubers that were not trained on. terms: (n, 6) of `view_terms`.
        tuber: (n,) whose view it is. belt_slope: as for `fit_scale`.
    """
    names, owner = np.unique(tuber, return_inverse=True)
    error_g = weight_g - predicted_g
    scale = _scale(terms, error_g, owner, belt_slope)
    residual = error_g / scale.scale_g(terms)
    if len(names) > 1:
        fold = np.random.default_rng(0).permutation(len(names))[owner] % FOLDS
        for which in np.unique(fold):
            rows = fold == which
            others = _scale(terms[~rows], error_g[~rows], owner[~rows], belt_slope)
            residual[rows] = error_g[rows] / others.scale_g(terms[rows])
    classes = [(predicted_g >= begin) & (predicted_g < end) for begin, end in pairwise(EDGES_G)]
    classes = [inside for inside in classes if len(np.unique(owner[inside])) >= SEEN_TAILS]
    at, below, above = [], [], []
    for inside in classes or [np.ones(len(owner), np.bool_)]:
        low, high = _reach(residual[inside], owner[inside], level)
        at.append(float(np.median(predicted_g[inside])))
        below.append(low)
        above.append(high)
    return IntervalRule(level, tuple(at), tuple(below), tuple(above), len(residual), scale)


def _scale(
    terms: NDArray[np.float64], error_g: NDArray[np.float64], owner: NDArray[np.int64], belt_slope: float | None
) -> ScaleRule:
    return fit_scale(terms, error_g, share=_shares(owner), prior=TYPICAL_SLOPES, ridge=SHRINK, belt_slope=belt_slope)


def _shares(owner: NDArray[np.int64]) -> NDArray[np.float64]:
    """(n,) of each view, one in all for each tuber."""
    shares: NDArray[np.float64] = 1.0 / np.bincount(owner)[owner]
    return shares


def _reach(residual: NDArray[np.float64], owner: NDArray[np.int64], level: float) -> tuple[float, float]:
    """Multiples of the scale from a prediction to both ends, from (n,) residuals of views of `owner`s."""
    owner = np.unique(owner, return_inverse=True)[1]
    share = _shares(owner)
    tubers = round(float(share.sum()))
    if tubers < SEEN_TAILS:
        spread = float(np.sqrt(share @ residual**2 / chdtri(tubers, CONFIDENCE)))
        half = float(ndtri((1 + level) / 2)) * spread
        return -half, half
    count = _independent(residual, share, owner, level)
    # So many draws cut what may come into count + 1 parts of equal chance: both tails get what the rank leaves of them.
    tail = (count + 1 - (holding_rank(count, coverage=level, confidence=CONFIDENCE) or count - 1)) / 2
    inside = (count + 1 - tail) / count
    return -_quantile(-residual, share, inside), _quantile(residual, share, inside)


def _independent(
    residual: NDArray[np.float64], share: NDArray[np.float64], owner: NDArray[np.int64], level: float
) -> int:
    """As many draws as these views are worth: so many would know the share of what is held as well.

    From the number of tubers, where all views of one are held or none, to that of views.
    """
    half = (1 + level) / 2
    low, high = -_quantile(-residual, share, half), _quantile(residual, share, half)
    held = np.bincount(owner, share * ((residual >= low) & (residual <= high)))
    mean, spread = float(held.mean()), max(float(held.var(ddof=1)), 1e-9)
    return int(np.clip(len(held) * mean * (1 - mean) / spread, len(held), len(residual)))


def _quantile(values: NDArray[np.float64], share: NDArray[np.float64], inside: float) -> float:
    """The least of `values` up to which at least `inside` of all shares lie."""
    order = np.argsort(values)
    reached = np.cumsum(share[order]) / share.sum()
    return float(values[order][min(int(np.searchsorted(reached, inside - 1e-9)), len(order) - 1)])


def interval_told(tubers: int, recordings: int) -> str:
    """For people: what an interval was calibrated on, what it promises and, where it is little, what to do.

    Args:
        tubers: how many there were. recordings: how many were known and counted; 0 where tubers are what counts.
    """
    if recordings:
        return f"90 % intervals are calibrated over {recordings} recordings"
    promise = (
        f"90 % intervals are calibrated over {tubers} tubers, and wide enough to hold at least 90 % of views in 9 of "
        "10 such calibrations; the fewer tubers, the wider"
    )
    if tubers >= SEEN_TAILS:
        return promise
    promise += f". With fewer than {SEEN_TAILS} their errors are taken for normal"
    if tubers >= MIN_TUBERS:
        return promise
    return (
        f"{promise}; {tubers} are very few: weigh {MIN_TUBERS} tubers or more that no training has seen, {SEEN_TAILS} "
        "better, and give them to `tuberline calibrate-interval`"
    )
