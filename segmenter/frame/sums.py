"""Sums over each instance of a label image, in one pass over its cells."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel
from segmenter.frame.marks import marked, row_of_marks

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
PER_STEP, LAST_STEP = np.float32(1 / STEP_MM), np.float32(STEPS - 1)
"""A power of two: a step that is multiplied for is the one that is divided for."""


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
        height_mm: (h, w) float32 height over the belt, not negative.
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


@kernel(error_model="numpy")
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
    marks, room = row_of_marks(columns)
    # What the slope of the heights has of a cell's column; room for the areas of a run of cells.
    of_column, room_mm2 = np.empty(columns), np.empty(columns)
    for j in range(columns):
        of_column[j] = a * (j * stride + half)
    for i in range(rows):
        own, high = labels[i], height_mm[i]
        _mark_ends(own, marks)
        down = b * (i * stride + half)
        first = 0
        # Runs of one label along a row: its row of the table is read and written once for each of them.
        for last in marked(marks, room):
            k = own[last]
            if k > 0:
                s, counts = sums[k], histogram[k]
                run_mm, areas_mm2 = high[first : last + 1], room_mm2[first : last + 1]
                _areas(run_mm, of_column[first : last + 1], down, c, t, area_factor, areas_mm2)
                area_mm2, volume_mm3, peak_mm = s.area_mm2, s.volume_mm3, s.peak_mm
                for j in range(len(run_mm)):
                    h = run_mm[j]
                    area_mm2 += areas_mm2[j]
                    volume_mm3 += areas_mm2[j] * h
                    peak_mm = max(peak_mm, h)
                    counts[np.uint32(min(h * PER_STEP, LAST_STEP))] += 1
                s.area_mm2, s.volume_mm3, s.peak_mm = area_mm2, volume_mm3, peak_mm
                cells = last + 1 - first
                s.cells += cells
                s.columns += cells * (first + last) // 2
                s.rows += cells * i
                s.top += cells if i < margin else 0
                s.bottom += cells if i >= rows - margin else 0
                s.left += max(0, min(last + 1, margin) - first)
                s.right += max(0, last + 1 - max(first, columns - margin))
                s.first_row = min(s.first_row, i)
                s.last_row = max(s.last_row, i)
                s.first_column = min(s.first_column, first)
                s.last_column = max(s.last_column, last)
            first = last + 1
        above, below = labels[max(i - 1, 0)], labels[min(i + 1, rows - 1)]  # at the border a cell is its own neighbour
        _mark_outline(own, above, below, marks)
        for j in marked(marks, room):
            k = own[j]
            before, after = own[max(j - 1, 0)], own[min(j + 1, columns - 1)]
            sums[k].outline += 1
            sums[k].touching += (
                (above[j] != k and above[j] > 0)
                or (below[j] != k and below[j] > 0)
                or (before != k and before > 0)
                or (after != k and after > 0)
            )


@kernel(error_model="numpy")
def _areas(
    high_mm: NDArray[np.float32],
    of_column: NDArray[np.float64],
    down: float,
    c: float,
    t: float,
    area_factor: float,
    areas_mm2: NDArray[np.float64],
) -> None:
    """Write the belt areas that the cells of a run cover, at the depths at which their rays have these heights.

    Over slices and without a branch, so that the compiler takes several cells at once.
    """
    for j in range(len(high_mm)):
        slope = of_column[j] + down + c
        z = (high_mm[j] - t) / slope
        areas_mm2[j] = area_factor * z * z / abs(slope * 1e-3)


@kernel()
def _mark_ends(own: NDArray[np.int32], marks: NDArray[np.uint8]) -> None:
    """Mark the last cell of each run of one label along a row."""
    last = len(own) - 1
    for j in range(last):
        marks[j] = own[j] != own[j + 1]
    marks[last] = 1


@kernel()
def _mark_outline(
    own: NDArray[np.int32], above: NDArray[np.int32], below: NDArray[np.int32], marks: NDArray[np.uint8]
) -> None:
    """Mark the labelled cells of a row with a neighbour of another label, or of none."""
    last = len(own) - 1
    for j in (0, last):
        k = own[j]
        beside = own[min(j + 1, last)] != k or own[max(j - 1, 0)] != k
        marks[j] = k > 0 and (above[j] != k or below[j] != k or beside)
    before, here, after = own[:-2], own[1:-1], own[2:]
    inner, inner_above, inner_below = marks[1:], above[1:], below[1:]
    for j in range(last - 1):  # without a branch, so that the compiler takes several cells at once
        k = here[j]
        differs = (inner_above[j] != k) | (inner_below[j] != k) | (before[j] != k) | (after[j] != k)
        inner[j] = (k > 0) & differs
