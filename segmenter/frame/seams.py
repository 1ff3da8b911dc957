"""Seams between neighbouring instances, and over-segmentation fragments merged back into their tubers.

A knob on a tuber can get a peak of its own and become a fragment. What tells it from a small neighbour is the seam: a
fragment shares much of its outline with one instance, and along that seam the surface neither dips towards the belt nor
jumps. The two make up for one another: where the seam is nearly as high as the fragment itself, it may be short. What
the first or last row cuts is left alone: a tuber that enters the view looks like a fragment of its neighbour, a few
frames later it does not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel
from segmenter.frame.flood import relabel
from segmenter.frame.marks import marked, row_of_marks

MOST_INSTANCES = 600
END_ROWS = 2


@dataclass(frozen=True, slots=True)
class SeamSettings:
    """When an instance smaller than `max_area_mm2` is merged into its main neighbour.

    On simulated belts this merges 146 of 200 pieces of knobby tubers, and none of 1237 small tubers beside others.

    Attributes:
        min_top_mm: lower is no fragment but belt beside the tuber, cleat or soil.
        min_height_share: mean height along the seam over its own highest point.
        min_sum: of that share and the share of its outline that the seam makes up;
        small_area_mm2, min_sum_large: for what is larger, a small tuber may be, a clearer one.
        max_jump_mm: mean step across the seam, two cells to either side; more is one tuber lying over another.
    """

    max_area_mm2: float = 2500.0
    min_top_mm: float = 20.0
    min_height_share: float = 0.72
    min_sum: float = 1.05
    small_area_mm2: float = 1000.0
    min_sum_large: float = 1.12
    max_jump_mm: float = 10.0


def merge_fragments(
    labels: NDArray[np.int32], n: int, height_mm: NDArray[np.float32], cell_mm: float, seam: SeamSettings
) -> int:
    """Merge fragments into their tubers, in place; returns how many.

    Args:
        labels: (h, w) int32, 1..n, 0 = none; numbers of merged fragments vanish.
        n: highest label.
        height_mm: (h, w) float32.
        cell_mm: size of a cell.
        seam: when to merge.
    """
    if n < 2 or n > MOST_INSTANCES:
        return 0
    seams = _seams(labels, n, height_mm)
    names = np.arange(n + 1, dtype=np.int32)
    # Small ones first, so that a fragment of a fragment ends up with the tuber.
    order = np.argsort(seams.cells[1:], kind="stable") + 1
    for small in order.tolist():
        other = _main_neighbour(seams, small, cell_mm, seam)
        if other is not None:
            names[names == small] = names[other]
    merged = int((names != np.arange(n + 1)).sum())
    if merged:
        relabel(labels, names)
    return merged


class _Seams(NamedTuple):
    """Sums over the cells of all seams.

    Attributes:
        length, height_mm, jump_mm: (n + 1, n + 1) cells, sum of the lower heights along, and of the steps across the
            seam of two labels.
        cells, outline, top_mm: (n + 1,) cells, outline cells and highest point of each label.
        at_end: (n + 1,) bool, it reaches the first or last rows.
    """

    length: NDArray[np.float64]
    height_mm: NDArray[np.float64]
    jump_mm: NDArray[np.float64]
    cells: NDArray[np.float64]
    outline: NDArray[np.float64]
    top_mm: NDArray[np.float64]
    at_end: NDArray[np.bool_]


def _main_neighbour(seams: _Seams, small: int, cell_mm: float, seam: SeamSettings) -> int | None:
    """The instance that `small` is a fragment of; None where it stands for itself."""
    area_mm2 = seams.cells[small] * cell_mm**2
    if area_mm2 == 0 or area_mm2 > seam.max_area_mm2:
        return None
    if seams.top_mm[small] < seam.min_top_mm or seams.at_end[small]:
        return None
    other = int(np.argmax(seams.length[small]))
    count = seams.length[small, other]
    if count == 0 or seams.cells[other] < seams.cells[small]:
        return None
    if seams.jump_mm[small, other] > seam.max_jump_mm * count:
        return None
    height_share = seams.height_mm[small, other] / count / seams.top_mm[small]
    least = seam.min_sum_large if area_mm2 > seam.small_area_mm2 else seam.min_sum
    clear = height_share >= seam.min_height_share and height_share + count / seams.outline[small] >= least
    return other if clear else None


@kernel()
def _add_seam(
    labels: NDArray[np.int32],
    height_mm: NDArray[np.float32],
    i: int,
    j: int,
    di: int,
    dj: int,
    length: NDArray[np.float64],
    height: NDArray[np.float64],
    jump: NDArray[np.float64],
    outline: NDArray[np.float64],
) -> None:
    """Book the edge between the cell (i, j) and its neighbour (i + di, j + dj), which has another label."""
    rows, columns = labels.shape
    y, x = i + di, j + dj
    a, b = labels[i, j], labels[y, x]
    outline[a] += 1
    outline[b] += 1
    if a == 0 or b == 0:
        return
    low = min(height_mm[i, j], height_mm[y, x])
    i2, j2, y2, x2 = max(0, i - di), max(0, j - dj), min(rows - 1, y + di), min(columns - 1, x + dj)
    step = abs(height_mm[i2, j2] - height_mm[y2, x2])
    length[a, b] += 1
    length[b, a] += 1
    height[a, b] += low
    height[b, a] += low
    jump[a, b] += step
    jump[b, a] += step


@kernel()
def _seams(labels: NDArray[np.int32], n: int, height_mm: NDArray[np.float32]) -> _Seams:
    rows, columns = labels.shape
    length = np.zeros((n + 1, n + 1))
    height = np.zeros((n + 1, n + 1))
    jump = np.zeros((n + 1, n + 1))
    cells = np.zeros(n + 1)
    outline = np.zeros(n + 1)
    top = np.zeros(n + 1)
    at_end = np.zeros(n + 1, np.bool_)
    beside, beside_room = row_of_marks(columns)
    under, under_room = row_of_marks(columns)
    for i in range(rows):
        end = i < END_ROWS or i >= rows - END_ROWS
        own, own_mm, below = labels[i], height_mm[i], labels[min(i + 1, rows - 1)]
        for j in range(columns - 1):  # without a branch, so that the compiler takes many cells at once
            beside[j] = own[j] != own[j + 1]
        beside[columns - 1] = 1
        for j in range(columns):
            under[j] = own[j] != below[j]
        first = 0
        # Runs of one label along a row: their cells and their highest point are booked once each.
        for last in marked(beside, beside_room):
            a = own[last]
            if a > 0:
                highest = np.float32(0.0)
                for j in range(first, last + 1):
                    highest = max(highest, own_mm[j])
                cells[a] += last + 1 - first
                top[a] = max(top[a], highest)
                at_end[a] |= end
            first = last + 1
            if first < columns:
                _add_seam(labels, height_mm, i, last, 0, 1, length, height, jump, outline)
        for j in marked(under, under_room):
            _add_seam(labels, height_mm, i, j, 1, 0, length, height, jump, outline)
    return _Seams(length, height, jump, cells, outline, top, at_end)
