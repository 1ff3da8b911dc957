"""Numba kernels of the splitter: descending flood with dynamics, and regrowth."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

LEVEL_MM = 0.25
"""Millimetres of relief per level of the counting sort: finer than any dynamics that matter."""
PER_MM = np.float32(1 / LEVEL_MM)
MOST_LEVELS = 65535
"""16 m of relief: what is higher is flooded as if it were as high."""
BACKGROUND = np.float32(-1)
"""Its relief; its level is 0."""


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def _find(parents: NDArray[np.int32], peak: Any) -> Any:
    while parents[peak] != peak:
        parents[peak] = parents[parents[peak]]
        peak = parents[peak]
    return peak


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def flood(
    relief_mm: NDArray[np.float32], foreground: NDArray[np.uint8], least_mm: float, share: float
) -> tuple[NDArray[np.int32], int]:
    """Basins of a relief, flooded from its peaks downwards.

    Two basins that meet become one when the lower peak rises less than max(`least_mm`, `share` * its own height) over
    the pass between them; this replaces h-maxima and a watershed by one pass over the cells in falling order.

    A cell belongs to the basin of its highest neighbour that comes before it in that order, whatever was merged until
    then. So basins are found by following neighbours upwards, and only cells between two basins are sorted and flooded.

    Args:
        relief_mm: (h, w) float32, high inside tubers, not negative.
        foreground: (h, w) uint8, cells to label.
        least_mm, share: the dynamics a peak needs.

    Returns:
        ((h, w) int32 labels 1..n, 0 elsewhere; n)
    """
    relief, levels = _rimmed(relief_mm, foreground)
    width = relief_mm.shape[1] + 2
    basins, peaks = _basins(relief, levels, width)
    parents = np.arange(len(peaks)).astype(np.int32)
    for cell in _falling(*_between(basins, levels, width)):
        _meet(cell, basins, levels, relief, width, peaks, parents, least_mm, share)
    return _named(basins, levels, peaks, parents, relief_mm.shape)


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def _rimmed(relief_mm: NDArray[np.float32], foreground: NDArray[np.uint8]) -> tuple[NDArray[Any], NDArray[Any]]:
    """((h + 2) * (w + 2),) relief and its levels with a rim of background, so that no neighbour needs a check."""
    rows, columns = relief_mm.shape
    width = columns + 2
    relief, levels = np.full((rows + 2) * width, BACKGROUND), np.zeros((rows + 2) * width, np.uint16)
    for i in range(rows):
        first = (i + 1) * width + 1
        own, of_level = relief[first : first + columns], levels[first : first + columns]
        for j in range(columns):  # without a branch, so that the compiler takes several cells at once
            steps = min(max(relief_mm[i, j] * PER_MM, np.float32(0)), np.float32(MOST_LEVELS - 1))
            own[j] = relief_mm[i, j] if foreground[i, j] else BACKGROUND
            of_level[j] = np.uint16(np.int32(steps) + 1) if foreground[i, j] else np.uint16(0)
    return relief, levels


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def _around(width: int) -> tuple[Any, Any]:
    """Steps to the four neighbours before a cell and the four after it, unsigned: a step back goes around the end of
    the numbers, and no index needs a check for what a negative one means.
    """
    before = np.uintp(-width - 1), np.uintp(-width), np.uintp(-width + 1), np.uintp(-1)
    after = np.uintp(1), np.uintp(width - 1), np.uintp(width), np.uintp(width + 1)
    return before, after


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def _basins(
    relief: NDArray[np.float32], levels: NDArray[np.uint16], width: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Before anything is merged: (cells,) -1 - the row of the peak that each leads up to, 0 in the background; (peaks,)
    their cells. Cells of one level come in the order of their rows and columns.
    """
    basins = np.zeros(len(levels), np.int32)
    peaks = np.empty(len(levels), np.int32)
    found = 0
    before, after = _around(width)
    for cell in range(np.uintp(len(levels))):
        level = levels[cell]
        if level == 0:
            continue
        highest, up = BACKGROUND, np.uintp(0)
        for step in before + after:
            if relief[cell + step] > highest:
                highest, up = relief[cell + step], cell + step
        if levels[up] <= level:  # it may come later: of this level only those before are asked
            highest, up = BACKGROUND, np.uintp(0)
            for step in before:
                if levels[cell + step] == level and relief[cell + step] > highest:
                    highest, up = relief[cell + step], cell + step
        basins[cell] = up
        if up == 0:
            peaks[found] = cell
            found += 1
            basins[cell] = -found
    for cell in range(len(levels)):
        if basins[cell] > 0:
            top = basins[basins[cell]]
            while top > 0:
                top = basins[top]
            step = cell
            while basins[step] > 0:
                basins[step], step = top, basins[step]
    return basins, peaks[:found]


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def _between(
    basins: NDArray[np.int32], levels: NDArray[np.uint16], width: int
) -> tuple[NDArray[np.int32], NDArray[np.uint16]]:
    """(n,) cells with a neighbour that comes before them and leads up to another peak than they do; their levels."""
    cells = np.empty(len(levels), np.int32)
    n = 0
    before, after = _around(width)
    for cell in range(np.uintp(len(levels))):
        basin, level = basins[cell], levels[cell]
        if level == 0:
            continue
        met = False
        for step in before:
            met = met or (basins[cell + step] != basin and levels[cell + step] >= level)
        for step in after:
            met = met or (basins[cell + step] != basin and levels[cell + step] > level)
        if met:
            cells[n] = cell
            n += 1
    return cells[:n], levels[cells[:n]]


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def _falling(cells: NDArray[np.int32], levels: NDArray[np.uint16]) -> NDArray[np.int32]:
    """The cells, highest level first, in their order within a level: a counting sort."""
    highest = 0
    for level in levels:
        highest = max(highest, level)
    counts = np.zeros(highest + 1, np.int64)
    for level in levels:
        counts[level] += 1
    before = 0
    for level in range(highest, -1, -1):
        before, counts[level] = before + counts[level], before
    order = np.empty_like(cells)
    for n in range(len(cells)):
        order[counts[levels[n]]] = cells[n]
        counts[levels[n]] += 1
    return order


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def _meet(
    cell: int,
    basins: NDArray[np.int32],
    levels: NDArray[np.uint16],
    relief: NDArray[np.float32],
    width: int,
    peaks: NDArray[np.int32],
    parents: NDArray[np.int32],
    least_mm: float,
    share: float,
) -> None:
    """Merge what meets at a cell: it is the pass between the basins around it, the highest, for cells come falling.

    Args:
        parents: union-find forest over the peaks; a root is the highest peak of its basin.
    """
    root = _find(parents, -1 - basins[cell])
    for step in (-width - 1, -width, -width + 1, -1, 1, width - 1, width, width + 1):
        near = cell + step
        if levels[near] >= levels[cell] + (step > 0):
            other = _find(parents, -1 - basins[near])
            if other != root:
                low, high = (other, root) if relief[peaks[other]] < relief[peaks[root]] else (root, other)
                top = relief[peaks[low]]
                # The lower peak hardly rises over the pass: no tuber of its own.
                if top - relief[cell] < max(least_mm, share * top):
                    parents[low] = high
                    root = high


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def _named(
    basins: NDArray[np.int32],
    levels: NDArray[np.uint16],
    peaks: NDArray[np.int32],
    parents: NDArray[np.int32],
    shape: tuple[int, int],
) -> tuple[NDArray[np.int32], int]:
    """Number the basins 1..n, highest peak first, without the rim."""
    falling = np.empty(len(peaks), np.int64)
    for k in range(len(peaks)):
        falling[k] = -np.int64(levels[peaks[k]]) * len(levels) + peaks[k]
    names = np.zeros(len(peaks) + 1, np.int32)
    n = 0
    for k in np.argsort(falling):
        root = _find(parents, k) + 1
        if names[root] == 0:
            n += 1
            names[root] = n
    for k in range(len(peaks)):
        names[k + 1] = names[_find(parents, k) + 1]
    labels = np.empty(shape, np.int32)
    rows, columns = shape
    for i in range(rows):
        for j in range(columns):
            labels[i, j] = names[-basins[(i + 1) * (columns + 2) + j + 1]]
    return labels, n


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def regrow(labels: NDArray[np.int32], height_mm: NDArray[np.float32], floor_mm: float, steps: int) -> None:
    """Grow all labels ring by ring, in place, into unlabelled cells higher than `floor_mm`, at most `steps` cells."""
    rows, columns = labels.shape
    front = np.empty(rows * columns, np.int32)
    fresh = np.empty(rows * columns, np.int32)
    size = 0
    for i in range(rows):
        above, below = max(i - 1, 0), min(i + 1, rows - 1)  # a cell at the border is its own neighbour: it is labelled
        for j in range(columns):
            if labels[i, j] > 0:
                before, after = max(j - 1, 0), min(j + 1, columns - 1)
                if (
                    (labels[above, j] == 0 and height_mm[above, j] > floor_mm)
                    or (labels[below, j] == 0 and height_mm[below, j] > floor_mm)
                    or (labels[i, before] == 0 and height_mm[i, before] > floor_mm)
                    or (labels[i, after] == 0 and height_mm[i, after] > floor_mm)
                ):
                    front[size] = i * columns + j
                    size += 1
    flat, height = labels.reshape(-1), height_mm.reshape(-1)
    around = np.array([-columns - 1, -columns, -columns + 1, -1, 1, columns - 1, columns, columns + 1])
    for step in range(steps):
        grown = 0
        for index in range(size):
            cell = front[index]
            j = cell % columns
            inside = columns <= cell < (rows - 1) * columns and 0 < j < columns - 1
            for n in range(8):
                if step % 2 == 1 and n in (0, 2, 5, 7):
                    continue
                near = cell + around[n]
                if not inside and not (0 <= near < rows * columns and abs(near % columns - j) <= 1):
                    continue
                if flat[near] == 0 and height[near] > floor_mm:
                    flat[near] = flat[cell]
                    fresh[grown] = near
                    grown += 1
        if grown == 0:
            return
        front, fresh = fresh, front
        size = grown


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def relabel(labels: NDArray[np.int32], names: NDArray[np.int32]) -> None:
    """Rename labels in place: label k becomes `names[k]`."""
    for i in range(labels.shape[0]):
        for j in range(labels.shape[1]):
            if labels[i, j] > 0:
                labels[i, j] = names[labels[i, j]]
