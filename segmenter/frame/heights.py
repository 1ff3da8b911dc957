"""Height over the belt on the analysis raster: blocks of the depth image, about 1.0-1.5 mm per cell on the belt."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.constants import CEILING_MM, GAP_MM
from segmenter.frame.marks import WORD, marked, row_of_marks

ALL_SEEN = np.uint64(0x0101010101010101)
"""What a word of marks holds where all of its cells are seen."""


@dataclass(frozen=True, slots=True)
class HeightMap:
    """Height over the belt of one frame.

    Attributes:
        height_mm: (h, w) float32, 0 on and below the belt and where nothing is known; small gaps are closed.
        seen: (h, w) uint8, 1 where the camera measured.
        stride: full-resolution pixels per cell, both ways; cell (i, j) covers rows i*stride ... (i+1)*stride - 1.
        cell_mm: size of a cell on the belt's load, millimetres.
    """

    height_mm: NDArray[np.float32]
    seen: NDArray[np.uint8]
    stride: int
    cell_mm: float


def height_map(depth: NDArray[np.uint16], *, depth_scale_m: float, belt: BeltGeometry, pixel_mm: float) -> HeightMap:
    """The height map of a depth image.

    Args:
        depth: (H, W) uint16, units of `depth_scale_m` metres, 0 = no depth.
        depth_scale_m: metres per unit.
        belt: intrinsics and belt pose.
        pixel_mm: wanted size of a cell; the nearest whole number of pixels is taken.
    """
    footprint_mm = belt.footprint_mm()
    stride = max(1, round(pixel_mm / footprint_mm))
    a, b, c, t = (1000.0 * value for value in belt.height_coefficients())
    height_mm, seen = _blocks(np.ascontiguousarray(depth), depth_scale_m, a, b, c, t, stride, CEILING_MM)
    cell_mm = footprint_mm * stride
    _close_gaps(height_mm, seen, max(1, int(GAP_MM / cell_mm)))
    return HeightMap(height_mm, seen, stride, cell_mm)


@kernel()
def _blocks(
    depth: NDArray[np.uint16], scale: float, a: float, b: float, c: float, t: float, stride: int, ceiling: float
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Mean height of the measured pixels of each block."""
    rows, columns = depth.shape[0] // stride, depth.shape[1] // stride
    height = np.zeros((rows, columns), np.float32)
    seen = np.zeros((rows, columns), np.uint8)
    if stride == 1:
        # One pixel is its own mean: the same numbers without a branch, so that the compiler takes many at once.
        for i in range(rows):
            for j in range(columns):
                h = depth[i, j] * scale * (a * j + b * i + c) + t
                good = (depth[i, j] > 0) & (h < ceiling)
                seen[i, j] = good
                height[i, j] = h if good & (h > 0.0) else 0.0
        return height, seen
    for i in range(rows):
        for j in range(columns):
            total, count = 0.0, 0
            for v in range(i * stride, (i + 1) * stride):
                for u in range(j * stride, (j + 1) * stride):
                    d = depth[v, u]
                    if d > 0:
                        h = d * scale * (a * u + b * v + c) + t
                        if h < ceiling:
                            total += h
                            count += 1
            if count > 0:
                seen[i, j] = 1
                height[i, j] = max(0.0, total / count)
    return height, seen


@kernel()
def _close_gaps(height: NDArray[np.float32], seen: NDArray[np.uint8], longest: int) -> None:
    """Unseen runs between two seen cells of a row or a column take the lower side: a hole on a tuber becomes tuber, the
    shadow beside it becomes belt.
    """
    rows, columns = height.shape
    padded = -(-columns // WORD) * WORD
    here = np.zeros(padded, np.uint8)
    words = here.view(np.uint64)
    for i in range(rows):
        own, row = seen[i], height[i]
        for j in range(columns):
            here[j] = own[j]
        last = -1
        # Eight cells that are all seen, or all unseen, end no gap: they are passed over together.
        for n in range(len(words)):
            first = n * WORD
            if words[n] == ALL_SEEN and last == first - 1:
                last = first + WORD - 1
            elif words[n] != 0:
                for j in range(first, min(first + WORD, columns)):
                    if own[j]:
                        if 0 <= last < j - 1 and j - last - 1 <= longest:
                            low = min(row[last], row[j])
                            for k in range(last + 1, j):
                                row[k] = low
                        last = j
    marks, room = row_of_marks(columns)
    for i in range(1, rows):
        own, above = seen[i], seen[i - 1]
        for j in range(columns):  # without a branch, so that the compiler takes several cells at once
            marks[j] = (own[j] != 0) & (above[j] == 0)
        for j in marked(marks, room):
            _close_above(height, seen, i, j, longest)


@kernel()
def _close_above(height: NDArray[np.float32], seen: NDArray[np.uint8], i: int, j: int, longest: int) -> None:
    """Close the gap above cell (i, j), which is seen and the one over it not, if it is short enough and has an end."""
    last = i - 2
    while last >= 0 and not seen[last, j] and i - last - 1 <= longest:
        last -= 1
    if last >= 0 and seen[last, j] and i - last - 1 <= longest:
        low = min(height[last, j], height[i, j])
        for k in range(last + 1, i):
            height[k, j] = max(height[k, j], low)
