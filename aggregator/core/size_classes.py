"""How much of a load is of which class of size: estimates blur, so their histogram is unfolded before it is cut.

A tuber near a class's edge may be on either side of it. Counted by its estimate alone, a class in the middle of a load
loses tubers to its neighbours, for there are more to lose than to win. So the distribution of true sizes that would
have given this histogram is found first (Richardson 1972, Lucy 1974, "An iterative technique for the rectification of
observed distributions"), and says of each estimate with which probability it is of which class.

The errors of single tubers vanish with the count. What all of a load share, its camera's rim and its cultivar's shape,
does not: a class's interval is also moved by `SHARED_SD` of the sizes. What makes all weights of a load wrong, a belt
that lies lower than stated or a camera that reads too far, makes its sizes wrong too: a ticket corrects both
(`SIZE_OF_WEIGHT`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aggregator.core.size_bins import BINS, Bin
from conveyor.contract import SizeClass
from conveyor.statistics import NORMAL_90

ROUNDS = 3
"""More find finer structure and more noise: of 0, 3, 6, 12 and 30, this was best on drawn loads of 300 tubers."""
SHARED_SD = {"mesh": 0.025, "length": 0.025}
"""Of the size: standard deviation from recording to recording of the mean error of its tubers, on training worlds."""
SIZE_OF_WEIGHT = {"mesh": 0.36, "length": 0.25}
"""How a size grows with its tuber's weight where one cause moves both, as a power. A factor of all volumes: 1/3. A belt
that lies lower: 0.45, 0.33 and 0.37 for the mesh, 0.20, 0.11 and 0.29 for the length, views of three belts taken 2 mm
lower."""
OWN_SHARE = 0.75
"""Of the variance that a tuber's size states, the part that is its own; the rest is what its recording shares."""
LEAST_SD_MM = 0.3


@dataclass(frozen=True, slots=True)
class Share:
    """What of a load's sized tubers is of one class: shares of their number and of their weight.

    `own`: standard deviation by single tubers. `moved`: what is won (below zero: lost) were all sizes larger by one
    standard deviation of what a recording shares.
    """

    count: float
    count_own: float
    count_moved: float
    weight: float
    weight_own: float
    weight_moved: float

    @property
    def count_sd(self) -> float:
        """Standard deviation of the share of the number."""
        return math.hypot(self.count_own, self.count_moved)

    @property
    def weight_sd(self) -> float:
        """Standard deviation of the share of the weight."""
        return math.hypot(self.weight_own, self.weight_moved)


def class_shares(
    bins: Mapping[int, Bin],
    classes: Sequence[SizeClass],
    *,
    measure: str,
    weight_ratio: float = 1.0,
    weight_sd: float = 0.0,
) -> list[Share]:
    """The share of each class in the tubers of `bins` (by millimetre of their estimate); zeros where there are none.

    Args:
        weight_ratio: by what the weights of all these tubers were multiplied after a scale had spoken.
        weight_sd: what of their weights they may still all be off by, standard deviation as a share.
    """
    if not bins:
        return [Share(0.0, 0.0, 0.0, 0.0, 0.0, 0.0) for _ in classes]
    counts, grams, squares_g2, sd_mm = _arrays(bins)
    at_mm = np.asarray(np.arange(BINS) + 0.5, np.float64)
    density = _unfolded(counts, sd_mm, at_mm)
    scale = weight_ratio ** SIZE_OF_WEIGHT[measure]
    found = _belonging(density, sd_mm, at_mm, classes, scale)
    total, total_g = counts.sum(), grams.sum()
    shift = math.hypot(SHARED_SD[measure], SIZE_OF_WEIGHT[measure] * weight_sd)
    moved = [_belonging(density, sd_mm, at_mm, classes, scale * (1 + sign * shift)) for sign in (-1, 1)]
    shares = []
    for k in range(len(classes)):
        p = found[:, k]
        # One tuber more or less is never sure, however few an estimate puts near an edge.
        own = 1.0 + float(counts @ (p * (1 - p))), float((squares_g2 @ (p * (1 - p))) + squares_g2.sum() / total)
        apart = [float(per @ (moved[1][:, k] - moved[0][:, k])) / 2 for per in (counts, grams)]
        shares.append(
            Share(
                count=float(counts @ p / total),
                count_own=math.sqrt(own[0]) / float(total),
                count_moved=apart[0] / float(total),
                weight=float(grams @ p / total_g) if total_g else 0.0,
                weight_own=math.sqrt(own[1]) / float(total_g) if total_g else 0.0,
                weight_moved=apart[1] / float(total_g) if total_g else 0.0,
            )
        )
    return shares


def interval(share: float, sd: float) -> tuple[float, float]:
    """Bounds of the 90 % interval of a share, within 0 and 1."""
    return max(0.0, share - NORMAL_90 * sd), min(1.0, share + NORMAL_90 * sd)


def _arrays(bins: Mapping[int, Bin]) -> tuple[NDArray[np.float64], ...]:
    """(BINS,) counts, grams, squared grams, and the sd of one tuber's own error in each bin, millimetres."""
    counts, grams, squares = np.zeros(BINS), np.zeros(BINS), np.zeros(BINS)
    sd_mm = np.full(BINS, LEAST_SD_MM)
    for at, found in bins.items():
        counts[at], grams[at], squares[at] = found.count, found.grams, found.squares_g2
        sd_mm[at] = max(LEAST_SD_MM, math.sqrt(OWN_SHARE * found.variance_mm2 / found.count))
    return counts, grams, squares, sd_mm


def _unfolded(
    counts: NDArray[np.float64], sd_mm: NDArray[np.float64], at_mm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(BINS,) density of true sizes that explains the estimates; begun with the estimates, once blurred."""
    seen = np.flatnonzero(counts)
    kernel = _kernel(sd_mm[seen], at_mm[seen], at_mm)
    weights = counts[seen] / counts.sum()
    density = weights @ (kernel / kernel.sum(axis=1, keepdims=True))
    for _ in range(ROUNDS):
        explained = np.maximum(kernel @ density, 1e-300)
        density = density * ((weights / explained) @ kernel)
        density /= density.sum()
    return np.asarray(density)


def _kernel(
    sd_mm: NDArray[np.float64], seen_mm: NDArray[np.float64], true_mm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(seen, true) how likely an estimate is of each true size."""
    off = (seen_mm[:, None] - true_mm[None]) / sd_mm[:, None]
    return np.asarray(np.exp(-0.5 * off * off) / sd_mm[:, None])


def _belonging(
    density: NDArray[np.float64],
    sd_mm: NDArray[np.float64],
    at_mm: NDArray[np.float64],
    classes: Sequence[SizeClass],
    scale: float,
) -> NDArray[np.float64]:
    """(BINS, classes) probability that a tuber of a bin is of a class, were all sizes `scale` times as large."""
    kernel = _kernel(sd_mm, at_mm, at_mm) * density
    kernel /= np.maximum(kernel.sum(axis=1, keepdims=True), 1e-300)
    low = np.array([each.low_mm for each in classes])
    high = np.array([min(each.high_mm, 10.0 * BINS) for each in classes])
    # The part of each millimetre of true size, stretched by `scale`, that lies in a class.
    left, right = scale * (at_mm[:, None] - 0.5), scale * (at_mm[:, None] + 0.5)
    inside = np.clip(np.minimum(right, high) - np.maximum(left, low), 0.0, None) / scale
    return np.asarray(np.clip(kernel @ inside, 0.0, 1.0), np.float64)
