"""Heights around the rim of an instance: what tells a tuber that lies on others from one that stands on the belt.

A tuber on the belt falls off towards it within a few millimetres of its outline, and its outline is lower than
half of it somewhere. One that lies on others ends high above the belt, and looks down on its neighbours.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

STEP_MM = 1.0
STEPS = 256
"""Of the histograms of heights."""

INNER_MM = (2.4, 3.8)
EDGE_MM = (0.0, 1.5)
OUTER_MM = (1.4, 4.0)
"""Rings, millimetres from the outline: inside it, its edge, and outside it."""

RIM_HEIGHTS = ("edge_10", "inner_50", "inner_75", "outer_25", "outer_50", "outer_75")
"""What `rim_heights` gives: percentiles of the heights in each ring, millimetres."""
_QUANTILES = ((1, 0.10), (0, 0.50), (0, 0.75), (2, 0.25), (2, 0.50), (2, 0.75))


def rim_heights(
    labels: NDArray[np.int32], height_mm: NDArray[np.float32], label: int, box: NDArray[np.int64], cell_mm: float
) -> NDArray[np.float64]:
    """(6,) `RIM_HEIGHTS` of one instance, millimetres over the belt; NaN where a ring is empty.

    Args:
        labels: (h, w) int32, 0 = none.
        height_mm: (h, w) float32.
        label: of the instance.
        box: (4,) its first and last row, first and last column.
        cell_mm: size of a cell.
    """
    reach = int(np.ceil(OUTER_MM[1] / cell_mm)) + 1
    i0, i1 = max(0, int(box[0]) - reach), min(labels.shape[0], int(box[1]) + reach + 1)
    j0, j1 = max(0, int(box[2]) - reach), min(labels.shape[1], int(box[3]) + reach + 1)
    bounds = np.array([INNER_MM, EDGE_MM, OUTER_MM]) / cell_mm
    counts = _rings(labels[i0:i1, j0:j1], height_mm[i0:i1, j0:j1], label, bounds)
    return np.array([_quantile(counts[ring], share) for ring, share in _QUANTILES])


def _quantile(counts: NDArray[np.int64], share: float) -> float:
    total = int(counts.sum())
    if total == 0:
        return float("nan")
    return float(np.searchsorted(np.cumsum(counts), share * total) * STEP_MM)


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def _rings(
    labels: NDArray[np.int32], height_mm: NDArray[np.float32], label: int, bounds: NDArray[np.float64]
) -> NDArray[np.int64]:
    """(3, STEPS) histograms of the heights in the inner ring, at the edge, and in the outer ring."""
    rows, columns = labels.shape
    far = 3 * (rows + columns)
    # Chamfer distance, in thirds of a cell, of each cell to the nearest one on the other side of the outline.
    away = np.full((rows, columns), far, np.int32)
    for turn in range(2):
        for n in range(rows * columns):
            at = n if turn == 0 else rows * columns - 1 - n
            i, j = at // columns, at % columns
            inside = labels[i, j] == label
            best = away[i, j]
            for di in range(-1, 2):
                for dj in range(-1, 2):
                    y, x = i + di, j + dj
                    if (di == 0 and dj == 0) or y < 0 or x < 0 or y >= rows or x >= columns:
                        continue
                    step = 3 if di == 0 or dj == 0 else 4
                    best = min(best, step if (labels[y, x] == label) != inside else away[y, x] + step)
            away[i, j] = best
    counts = np.zeros((3, 256), np.int64)
    for i in range(rows):
        for j in range(columns):
            distance = away[i, j] / 3.0
            height = min(255, max(0, int(height_mm[i, j])))
            if labels[i, j] == label:
                if bounds[0, 0] < distance <= bounds[0, 1]:
                    counts[0, height] += 1
                if bounds[1, 0] < distance <= bounds[1, 1]:
                    counts[1, height] += 1
            elif bounds[2, 0] < distance <= bounds[2, 1]:
                counts[2, height] += 1
    return counts
