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


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator, unused-ignore]
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
        j = 0
        # Runs of one label along a row: its row of the table is read and written once for each of them.
        while j < columns:
            k = labels[i, j]
            first = j
            if k == 0:
                while j < columns and labels[i, j] == 0:
                    j += 1
                continue
            s = sums[k]
            area_mm2, volume_mm3, peak_mm = s.area_mm2, s.volume_mm3, s.peak_mm
            touching, outline = 0, 0
            while j < columns and labels[i, j] == k:
                h = height_mm[i, j]
                # Depth at which the cell's ray has this height, and the belt area that the cell covers there.
                slope = a * (j * stride + half) + b * (i * stride + half) + c
                z = (h - t) / slope
                area = area_factor * z * z / abs(slope * 1e-3)
                area_mm2 += area
                volume_mm3 += area * h
                peak_mm = max(peak_mm, h)
                histogram[k, min(STEPS - 1, int(h / STEP_MM))] += 1
                above = labels[i - 1, j] if i > 0 else k
                below = labels[i + 1, j] if i + 1 < rows else k
                before = labels[i, j - 1] if j > 0 else k
                after = labels[i, j + 1] if j + 1 < columns else k
                if above != k or below != k or before != k or after != k:
                    outline += 1
                    touching += (
                        (above != k and above > 0)
                        or (below != k and below > 0)
                        or (before != k and before > 0)
                        or (after != k and after > 0)
                    )
                j += 1
            cells = j - first
            s.cells += cells
            s.columns += cells * (first + j - 1) // 2
            s.rows += cells * i
            s.area_mm2, s.volume_mm3, s.peak_mm = area_mm2, volume_mm3, peak_mm
            s.top += cells if i < margin else 0
            s.bottom += cells if i >= rows - margin else 0
            s.left += max(0, min(j, margin) - first)
            s.right += max(0, j - max(first, columns - margin))
            s.first_row = min(s.first_row, i)
            s.last_row = max(s.last_row, i)
            s.first_column = min(s.first_column, first)
            s.last_column = max(s.last_column, j - 1)
            s.touching += touching
            s.outline += outline
