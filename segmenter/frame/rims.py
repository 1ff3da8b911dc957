"""Heights around the rim of an instance: what tells a tuber that lies on others from one that stands on the belt.

A tuber on the belt falls off towards it within a few millimetres of its outline, and its outline is lower than
half of it somewhere. One that lies on others ends high above the belt, and looks down on its neighbours.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel

STEP_MM = 1.0
STEPS = 256
"""Of the histograms of heights."""

INNER_MM = (2.4, 3.8)
EDGE_MM = (0.0, 1.5)
OUTER_MM = (1.4, 4.0)
"""Rings, millimetres from the outline: inside it, its edge, and outside it."""

RIM_HEIGHTS = ("edge_10", "inner_50", "inner_75", "outer_25", "outer_50", "outer_75")
"""What `rim_heights` gives: percentiles of the heights in each ring, millimetres."""
_RINGS, _SHARES = np.array([1, 0, 0, 2, 2, 2]), np.array([0.10, 0.50, 0.75, 0.25, 0.50, 0.75])
_BOUNDS_MM = np.array([INNER_MM, EDGE_MM, OUTER_MM])


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
    counts = _rings(labels[i0:i1, j0:j1], height_mm[i0:i1, j0:j1], label, _BOUNDS_MM / cell_mm)
    return _quantiles(counts, _RINGS, _SHARES)


@kernel()
def _quantiles(counts: NDArray[np.int64], rings: NDArray[np.int64], shares: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) the height that share n of the cells in ring n are not higher than; NaN where there are none."""
    found = np.full(len(rings), np.nan)
    for n in range(len(rings)):
        total = counts[rings[n]].sum()
        below, step = 0, 0
        while total > 0 and step < counts.shape[1]:
            below += counts[rings[n], step]
            if below >= shares[n] * total:
                found[n] = step * STEP_MM
                break
            step += 1
    return found


@kernel()
def _rings(
    labels: NDArray[np.int32], height_mm: NDArray[np.float32], label: int, bounds: NDArray[np.float64]
) -> NDArray[np.int64]:
    """(3, STEPS) histograms of the heights in the inner ring, at the edge, and in the outer ring."""
    rows, columns = labels.shape
    away = _away(labels, label)
    counts = np.zeros((3, STEPS), np.int64)
    farthest = np.int32(0)
    while (farthest + 1) / 3.0 <= max(bounds[0, 1], bounds[2, 1]):
        farthest += np.int32(1)
    for i in range(rows):
        for j in range(columns):
            if away[i + 1, j + 1] > farthest:
                continue
            distance = away[i + 1, j + 1] / 3.0
            height = min(STEPS - 1, max(0, int(height_mm[i, j])))
            if labels[i, j] == label:
                if bounds[0, 0] < distance <= bounds[0, 1]:
                    counts[0, height] += 1
                if bounds[1, 0] < distance <= bounds[1, 1]:
                    counts[1, height] += 1
            elif bounds[2, 0] < distance <= bounds[2, 1]:
                counts[2, height] += 1
    return counts


@kernel()
def _away(labels: NDArray[np.int32], label: int) -> NDArray[np.int32]:
    """(h + 2, w + 2) chamfer distance, in thirds of a cell, of each cell to the nearest one on the other side of the
    outline of `label`; a rim of one cell all round is far from it.

    Cells beside the outline are 3 or 4 away; two passes carry that on, whichever side a neighbour is on: over the
    other side no way is shorter (Borgefors 1986, "Distance transformations in digital images").
    """
    rows, columns = labels.shape
    far = 3 * (rows + columns)
    away = np.full((rows + 2, columns + 2), far, np.int32)
    for i in range(rows):
        for j in range(columns):
            inside = labels[i, j] == label
            if j + 1 < columns and (labels[i, j + 1] == label) != inside:
                away[i + 1, j + 1] = away[i + 1, j + 2] = 3
            if i + 1 == rows:
                continue
            if (labels[i + 1, j] == label) != inside:
                away[i + 1, j + 1] = away[i + 2, j + 1] = 3
            if j + 1 < columns and (labels[i + 1, j + 1] == label) != inside:
                away[i + 1, j + 1] = min(away[i + 1, j + 1], 4)
                away[i + 2, j + 2] = min(away[i + 2, j + 2], 4)
            if j > 0 and (labels[i + 1, j - 1] == label) != inside:
                away[i + 1, j + 1] = min(away[i + 1, j + 1], 4)
                away[i + 2, j] = min(away[i + 2, j], 4)
    # Each pass in two: what comes from the row beside is taken for many cells at once, what comes along the row not.
    for i in range(1, rows + 1):
        own, near = away[i], away[i - 1]
        for j in range(1, columns + 1):
            own[j] = min(min(own[j], near[j] + 3), min(near[j - 1], near[j + 1]) + 4)
        last = own[0]
        for j in range(1, columns + 1):
            last = min(own[j], last + 3)
            own[j] = last
    for i in range(rows, 0, -1):
        own, near = away[i], away[i + 1]
        for j in range(1, columns + 1):
            own[j] = min(min(own[j], near[j] + 3), min(near[j - 1], near[j + 1]) + 4)
        last = own[columns + 1]
        for j in range(columns, 0, -1):
            last = min(own[j], last + 3)
            own[j] = last
    return away
