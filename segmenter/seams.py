"""Seams between neighbouring instances, and slivers sewn back on.

A lump on a knobby tuber can get a peak of its own. What tells it from a small neighbour is the seam: a lump shares
much of its outline with one instance, and along that seam the surface neither dips towards the belt nor jumps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from segmenter.flood import relabel

MOST_INSTANCES = 600


@dataclass(frozen=True, slots=True)
class SeamSettings:
    """When an instance smaller than `max_area_mm2` is sewn to its main neighbour.

    Attributes:
        min_share: of its outline that the seam must make up.
        min_height_share: mean height along the seam over its own highest point.
        max_jump_mm: mean step across the seam, two cells to either side; more is one tuber lying over another.
    """

    max_area_mm2: float = 1500.0
    min_share: float = 0.30
    min_height_share: float = 0.72
    max_jump_mm: float = 10.0


def sew(labels: NDArray[np.int32], n: int, height_mm: NDArray[np.float32], cell_mm: float, seam: SeamSettings) -> int:
    """Sew slivers onto their tubers, in place; returns how many.

    Args:
        labels: (h, w) int32, 1..n, 0 = none; numbers of sewn instances vanish.
        n: highest label.
        height_mm: (h, w) float32.
        cell_mm: size of a cell.
        seam: when to sew.
    """
    if n < 2 or n > MOST_INSTANCES:
        return 0
    length, height, jump, cells, outline, top = _seams(labels, n, height_mm)
    names = np.arange(n + 1, dtype=np.int32)
    order = np.argsort(cells[1:], kind="stable") + 1
    for small in order.tolist():
        if cells[small] == 0 or cells[small] * cell_mm**2 > seam.max_area_mm2:
            continue
        other = int(np.argmax(length[small]))
        count = length[small, other]
        if count == 0 or cells[other] < cells[small] or count < seam.min_share * outline[small]:
            continue
        flush = jump[small, other] / count <= seam.max_jump_mm
        if flush and height[small, other] / count >= seam.min_height_share * top[small]:
            names[names == small] = names[other]
    sewn = int((names != np.arange(n + 1)).sum())
    if sewn:
        relabel(labels, names)
    return sewn


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def _seams(
    labels: NDArray[np.int32], n: int, height_mm: NDArray[np.float32]
) -> tuple[
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
]:
    """Per pair: length, sum of heights, sum of steps of the seam in cells; per label: cells, outline length, top."""
    rows, columns = labels.shape
    length = np.zeros((n + 1, n + 1))
    height = np.zeros((n + 1, n + 1))
    jump = np.zeros((n + 1, n + 1))
    cells = np.zeros(n + 1)
    outline = np.zeros(n + 1)
    top = np.zeros(n + 1)
    for i in range(rows):
        for j in range(columns):
            a = labels[i, j]
            if a > 0:
                cells[a] += 1
                top[a] = max(top[a], height_mm[i, j])
            for di, dj in ((0, 1), (1, 0)):
                y, x = i + di, j + dj
                if y >= rows or x >= columns:
                    continue
                b = labels[y, x]
                if a == b:
                    continue
                outline[a] += 1
                outline[b] += 1
                if a == 0 or b == 0:
                    continue
                low = min(height_mm[i, j], height_mm[y, x])
                i2, j2, y2, x2 = max(0, i - di), max(0, j - dj), min(rows - 1, y + di), min(columns - 1, x + dj)
                step = abs(height_mm[i2, j2] - height_mm[y2, x2])
                length[a, b] += 1
                length[b, a] += 1
                height[a, b] += low
                height[b, a] += low
                jump[a, b] += step
                jump[b, a] += step
    return length, height, jump, cells, outline, top
