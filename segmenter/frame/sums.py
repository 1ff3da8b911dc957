"""Sums over each instance of a label image, in one pass over its cells."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

InstanceSums = np.dtype(
    [
        ("cells", np.int64),
        ("columns", np.int64),  # sum of the cells' columns
        ("rows", np.int64),  # sum of the cells' rows
        ("area_mm2", np.float64),  # projected onto the belt
        ("volume_mm3", np.float64),  # under the visible surface
        ("top", np.int64),  # cells that touch the image's borders
        ("bottom", np.int64),
        ("left", np.int64),
        ("right", np.int64),
        ("first_row", np.int64),
        ("last_row", np.int64),
        ("first_column", np.int64),
        ("last_column", np.int64),
        ("touching", np.int64),  # outline cells next to another instance
        ("outline", np.int64),  # outline cells
        ("peak_mm", np.float64),
    ]
)
"""What is summed over each instance; row k of a table belongs to label k, row 0 to no label."""
BORDERS = ("top", "bottom", "left", "right")
BOX = ("first_row", "last_row", "first_column", "last_column")
STEPS, STEP_MM = 128, 2.0
"""Of the histogram of heights."""


def instance_sums(
    labels: NDArray[np.int32],
    n: int,
    height_mm: NDArray[np.float32],
    *,
    coefficients_mm: tuple[float, float, float, float],
    stride: int,
    area_factor: float,
    margin: int,
) -> tuple[NDArray[np.void], NDArray[np.int32]]:
    """Sums over each instance.

    Args:
        labels: (h, w) int32, 1..n, 0 = none.
        n: highest label.
        height_mm: (h, w) float32 height over the belt.
        coefficients_mm: (a, b, c, t) of `BeltGeometry.height_coefficients`, millimetres per metre and millimetres.
        stride: full-resolution pixels per cell.
        area_factor: stride**2 / (fx fy) * 1e6.
        margin: cells from the border that count as touching it.

    Returns:
        ((n + 1,) `InstanceSums`; (n + 1, STEPS) int32 histogram of heights in steps of `STEP_MM`)
    """
    sums = np.zeros(n + 1, InstanceSums)
    histogram = np.zeros((n + 1, STEPS), np.int32)
    sums["first_row"], sums["first_column"] = labels.shape
    sums["last_row"] = sums["last_column"] = -1
    _add_cells(labels, height_mm, *coefficients_mm, stride, area_factor, margin, sums, histogram)
    return sums, histogram


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def _add_cells(
    labels: NDArray[np.int32],
    height_mm: NDArray[np.float32],
    a: float,
    b: float,
    c: float,
    t: float,
    stride: int,
    area_factor: float,
    margin: int,
    sums: Any,
    histogram: NDArray[np.int32],
) -> None:
    rows, columns = labels.shape
    half = (stride - 1) / 2.0
    for i in range(rows):
        for j in range(columns):
            k = labels[i, j]
            if k == 0:
                continue
            s = sums[k]
            h = height_mm[i, j]
            # Depth at which the cell's ray has this height, and the belt area that the cell covers there.
            slope = a * (j * stride + half) + b * (i * stride + half) + c
            z = (h - t) / slope
            area = area_factor * z * z / abs(slope * 1e-3)
            s.cells += 1
            s.columns += j
            s.rows += i
            s.area_mm2 += area
            s.volume_mm3 += area * h
            s.top += i < margin
            s.bottom += i >= rows - margin
            s.left += j < margin
            s.right += j >= columns - margin
            s.first_row = min(s.first_row, i)
            s.last_row = max(s.last_row, i)
            s.first_column = min(s.first_column, j)
            s.last_column = max(s.last_column, j)
            s.peak_mm = max(s.peak_mm, h)
            histogram[k, min(STEPS - 1, int(h / STEP_MM))] += 1
            touching, outline = False, False
            for di, dj in ((-1, 0), (1, 0), (0, -1), (0, 1)):
                y, x = i + di, j + dj
                if 0 <= y < rows and 0 <= x < columns and labels[y, x] != k:
                    outline = True
                    if labels[y, x] > 0:
                        touching = True
            s.touching += touching
            s.outline += outline
