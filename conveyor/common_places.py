"""By how much two cameras disagree on the places of the tubers that both see: their places, laid over one another.

No tuber has a name, so every pair of one camera's tuber with one of the other's, alike in height and size, says by how
much the cameras might disagree. Pairs of two tubers say anything; those of one tuber seen twice all say the same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]
Indices = NDArray[np.int64]

CELL_M = 0.010
NEAR_M = 0.016
"""Metres by which pairs of one tuber may differ: half of it is the lean of what each camera sees."""
ALIKE_MM = 4.0
HIGHER_MM = (0.0, 4.0, -4.0, 8.0, -8.0, 12.0, -12.0)
ALIKE_SIZE = 0.3
"""Heights, and logarithms of sizes, by which one tuber may differ in two cameras, which look at it from two sides; and
by how much one of them may see all tubers higher, for a belt's distance is known to millimetres."""
HARDLY_MM, HARDLY_SIZE = 16.0, 0.5
"""The same under a camera whose tilt or belt is not known: places must do then."""
LEAST_PAIRS = 7
OVER_CHANCE = 3.0
"""Pairs, and times those that chance brings: fewer tell nothing."""
RIVAL, CLEAR_OF_RIVAL = 0.7, 1.3
"""Of the best offset's pairs that another one may have: tubers in even rows match at many. And by how many roots of the
rival's pairs it must be clear of that: of many tubers chance brings much to some offset."""
MEDIAN_ERROR = 1.4826 * 1.2533
"""Of a median, times the root of how many: of the median of distances from it."""
RING_M = 0.08
"""Around an offset chance is measured so far out."""


@dataclass(frozen=True, slots=True)
class Places:
    """Tubers as one camera has them, in any order.

    Attributes:
        xy_m: (n, 2) float64 places on the belt: along it and across.
        height_mm, size: (n,) float64 heights, and visible volumes or weights above 0, in any one unit.
    """

    xy_m: Values
    height_mm: Values
    size: Values


@dataclass(frozen=True, slots=True)
class Offset:
    """What one camera says, less what the other says, of the same tubers.

    Attributes:
        along_m, across_m: medians; along_sd_m, across_sd_m: their standard errors.
        higher_mm: median of the heights' differences.
        pairs: (n, 2) int, indices into the first and the second camera's tubers.
    """

    along_m: float
    across_m: float
    along_sd_m: float
    across_sd_m: float
    higher_mm: float
    pairs: Indices


def common_offset(first: Places, second: Places, *, along_m: float, across_m: float) -> Offset | None:
    """How far the second camera's places lie from the first one's, where both see the same tubers.

    Args:
        along_m, across_m: how far to look, each way.

    Returns:
        None where they share no tubers, or too few to tell.
    """
    if min(len(first.size), len(second.size)) < LEAST_PAIRS:
        return None
    reach_m = np.array([along_m, across_m])
    found = _clearest(*_hardly_alike(first, second, reach_m), reach_m)
    if found is None:
        return None
    i, j, apart_m, centre_m = found
    for _ in range(3):
        near = np.hypot(*(apart_m - centre_m).T) < NEAR_M
        centre_m = np.median(apart_m[near], axis=0) if near.any() else centre_m
    pairs = _one_to_one(i, j, np.hypot(*(apart_m - centre_m).T))
    if len(pairs) < max(LEAST_PAIRS, OVER_CHANCE * _by_chance(apart_m, centre_m)):
        return None
    moved_m = second.xy_m[pairs[:, 1]] - first.xy_m[pairs[:, 0]]
    middle_m = np.median(moved_m, axis=0)
    error_m = MEDIAN_ERROR * np.median(np.abs(moved_m - middle_m), axis=0) / math.sqrt(len(pairs))
    higher_mm = float(np.median(second.height_mm[pairs[:, 1]] - first.height_mm[pairs[:, 0]]))
    (x_m, y_m), (x_sd_m, y_sd_m) = middle_m.tolist(), error_m.tolist()
    return Offset(x_m, y_m, x_sd_m, y_sd_m, higher_mm, pairs)


def _clearest(
    i: Indices, j: Indices, apart_m: Values, higher_mm: Values, larger: Values, reach_m: Values
) -> tuple[Indices, Indices, Values, Values] | None:
    """The offset that stands out most, whether or not one camera sees all tubers higher: pairs that are alike then, how
    far apart they are, and the offset, (2,) metres; None where none stands out.
    """
    best: tuple[float, float, Values, NDArray[np.bool_]] | None = None
    for middle_mm in (*HIGHER_MM, None):
        alike = np.ones(len(i), bool)
        if middle_mm is not None:
            alike = (np.abs(higher_mm - middle_mm) <= ALIKE_MM) & (larger <= ALIKE_SIZE)
        counts = _smoothed(apart_m[alike], reach_m)
        at = np.unravel_index(int(np.argmax(counts)), counts.shape)
        most, rival = float(counts[at]), _rival(counts, at)
        if best is None or most - rival > best[0] - best[1]:
            best = most, rival, (np.array(at) - np.array(counts.shape) // 2) * CELL_M, alike
    assert best is not None
    most, rival, centre_m, alike = best
    if rival > min(RIVAL * most, most - CLEAR_OF_RIVAL * math.sqrt(rival)):
        return None
    return i[alike], j[alike], apart_m[alike], centre_m


def _hardly_alike(first: Places, second: Places, reach_m: Values) -> tuple[Indices, Indices, Values, Values, Values]:
    """Of the pairs within reach that may be one tuber: their indices, how far apart they are, (n, 2) metres, how much
    higher the second one is, (n,) millimetres, and by what logarithm one is larger than the other, (n,).
    """
    apart_m = second.xy_m[None] - first.xy_m[:, None]
    higher_mm = second.height_mm[None] - first.height_mm[:, None]
    larger = np.abs(np.log(second.size[None] / first.size[:, None]))
    alike = (np.abs(apart_m) <= reach_m).all(axis=2) & (np.abs(higher_mm) <= HARDLY_MM) & (larger <= HARDLY_SIZE)
    i, j = np.nonzero(alike)
    return i, j, apart_m[i, j], higher_mm[i, j], larger[i, j]


def _smoothed(apart_m: Values, reach_m: Values) -> Values:
    """Pairs by offset in cells, each with its eight neighbours; the middle cell is no offset."""
    half = np.ceil(reach_m / CELL_M).astype(int) + 2
    cells = np.rint(apart_m / CELL_M).astype(int) + half
    counts = np.zeros(2 * half + 1)
    np.add.at(counts, (cells[:, 0], cells[:, 1]), 1.0)
    padded = np.pad(counts, 1)
    rows, columns = counts.shape
    return np.asarray(sum(padded[a : a + rows, b : b + columns] for a in range(3) for b in range(3)))


def _rival(counts: Values, best: tuple[np.intp, ...]) -> float:
    """The most pairs of an offset that is another one than the best."""
    others = counts.copy()
    apart = 4
    others[tuple(slice(max(0, int(at) - apart), int(at) + apart + 1) for at in best)] = 0.0
    return float(others.max())


def _by_chance(apart_m: Values, centre_m: Values) -> float:
    """Pairs that lie within `NEAR_M` of an offset by chance, by those around it."""
    away_m = np.hypot(*(apart_m - centre_m).T)
    ring = np.count_nonzero((away_m > 2 * NEAR_M) & (away_m < RING_M))
    return float(ring * NEAR_M**2 / (RING_M**2 - (2 * NEAR_M) ** 2))


def _one_to_one(i: Indices, j: Indices, away_m: Values) -> Indices:
    """(n, 2) pairs within `NEAR_M`, nearest first, each tuber once."""
    taken: tuple[set[int], set[int]] = (set(), set())
    pairs = []
    for k in np.argsort(away_m, kind="stable"):
        if away_m[k] >= NEAR_M:
            break
        a, b = int(i[k]), int(j[k])
        if a not in taken[0] and b not in taken[1]:
            taken[0].add(a)
            taken[1].add(b)
            pairs.append((a, b))
    return np.array(pairs, np.int64).reshape(-1, 2)
