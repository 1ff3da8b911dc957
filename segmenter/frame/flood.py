"""Numba kernels of the splitter: descending flood with dynamics, and regrowth."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

LEVEL_MM = 0.25
"""Millimetres of relief per level of the counting sort: finer than any dynamics that matter."""
MOST_LEVELS = 65535
"""16 m of relief: what is higher is flooded as if it were as high."""
RELIEF, PARENT = 0, 1
"""Columns of a node. Its relief stands there as its float32 bits, which order as the heights do where none is negative:
so all that is asked of a neighbour lies in one place of the memory."""


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def _find(nodes: NDArray[np.int32], node: Any) -> Any:
    while nodes[node, PARENT] != node:
        nodes[node, PARENT] = nodes[nodes[node, PARENT], PARENT]
        node = nodes[node, PARENT]
    return node


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def _falling(levels: NDArray[np.uint16], counts: NDArray[np.int64], count: int) -> NDArray[np.int32]:
    """Cells with a level above 0, highest level first: a counting sort. `counts`: cells of each level."""
    top = len(counts) - 1
    starts = np.zeros(top + 2, np.int64)
    for level in range(top, 0, -1):
        starts[top - level + 1] = starts[top - level] + counts[level]
    order = np.empty(count, np.int32)
    for cell in range(len(levels)):
        height = np.int64(levels[cell])
        if height > 0:
            order[starts[top - height]] = cell
            starts[top - height] += 1
    return order


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def _named(
    nodes: NDArray[np.int32], peaks: NDArray[np.int32], foreground: NDArray[np.uint8]
) -> tuple[NDArray[np.int32], int]:
    """Number the basins 1..n, highest peak first, without the rim of one cell that `flood` works with.

    The first cell of a basin was a peak, so that the peaks alone, in falling order, tell the order of the basins.
    """
    rows, columns = foreground.shape
    width = columns + 2
    labels = np.zeros((rows, columns), np.int32)
    names = np.zeros(len(nodes), np.int32)
    n = 0
    for peak in peaks:
        root = _find(nodes, peak)
        if names[root] == 0:
            n += 1
            names[root] = n
    for i in range(rows):
        for j in range(columns):
            if foreground[i, j]:
                labels[i, j] = names[_find(nodes, (i + 1) * width + j + 1)]
    return labels, n


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def flood(
    relief_mm: NDArray[np.float32], foreground: NDArray[np.uint8], least_mm: float, share: float
) -> tuple[NDArray[np.int32], int]:
    """Basins of a relief, flooded from its peaks downwards.

    Two basins that meet become one when the lower peak rises less than max(`least_mm`, `share` * its own height) over
    the pass between them; this replaces h-maxima and a watershed by one pass over the cells in falling order.

    Args:
        relief_mm: (h, w) float32, high inside tubers.
        foreground: (h, w) uint8, cells to label.
        least_mm, share: the dynamics a peak needs.

    Returns:
        ((h, w) int32 labels 1..n, 0 elsewhere; n)
    """
    # A rim of one cell around the image, so that no neighbour needs a check of the border.
    rows, columns = relief_mm.shape
    width = columns + 2
    highest_mm = np.float32(0.0)
    for i in range(rows):
        for j in range(columns):
            if foreground[i, j]:
                highest_mm = max(highest_mm, relief_mm[i, j])
    # `PARENT` is a union-find forest over the basins; a root is the peak of its basin. -1: not flooded yet.
    nodes = np.full(((rows + 2) * width, 2), np.int32(-1), np.int32)
    relief = nodes.view(np.float32)
    levels = np.zeros((rows + 2) * width, np.uint16)
    counts = np.zeros(min(int(highest_mm / LEVEL_MM) + 1, MOST_LEVELS) + 1, np.int64)
    count = 0
    for i in range(rows):
        for j in range(columns):
            if foreground[i, j]:
                cell = (i + 1) * width + j + 1
                relief[cell, RELIEF] = relief_mm[i, j]
                level = min(max(0, int(relief_mm[i, j] / LEVEL_MM)) + 1, MOST_LEVELS)
                levels[cell] = level
                counts[level] += 1
                count += 1
    order = _falling(levels, counts, count)
    peaks = np.empty(count, np.int32)
    found = 0
    for cell in order:
        # The cell joins the basin of its highest flooded neighbour; without one it is a peak of its own.
        home, highest, first, meet = np.int32(-1), np.int32(-1), np.int32(-1), False
        for step in (-width - 1, -width, -width + 1, -1, 1, width - 1, width, width + 1):
            near = cell + step
            parent = nodes[near, PARENT]
            if parent >= 0:
                if nodes[near, RELIEF] > highest:
                    highest = nodes[near, RELIEF]
                    home = near
                if first >= 0 and parent != first:
                    meet = True
                first = parent
        if home < 0:
            nodes[cell, PARENT] = cell
            peaks[found] = cell
            found += 1
            continue
        root = _find(nodes, home)
        nodes[cell, PARENT] = root
        if not meet:
            continue
        # Where it touches other basins it is the pass between them: the highest, for cells come in falling order.
        for step in (-width - 1, -width, -width + 1, -1, 1, width - 1, width, width + 1):
            near = cell + step
            if nodes[near, PARENT] >= 0 and nodes[near, PARENT] != root:
                other = _find(nodes, near)
                if other != root:
                    low, high = (other, root) if nodes[other, RELIEF] < nodes[root, RELIEF] else (root, other)
                    # The lower peak hardly rises over the pass: no tuber of its own.
                    if relief[low, RELIEF] - relief[cell, RELIEF] < max(least_mm, share * relief[low, RELIEF]):
                        nodes[low, PARENT] = high
                        root = high
    return _named(nodes, peaks[:found], foreground)


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def regrow(labels: NDArray[np.int32], height_mm: NDArray[np.float32], floor_mm: float, steps: int) -> None:
    """Grow all labels ring by ring, in place, into unlabelled cells higher than `floor_mm`, at most `steps` cells."""
    rows, columns = labels.shape
    front = np.empty(rows * columns, np.int32)
    fresh = np.empty(rows * columns, np.int32)
    size = 0
    for i in range(rows):
        for j in range(columns):
            if labels[i, j] > 0:
                edge = False
                for di, dj in ((-1, 0), (1, 0), (0, -1), (0, 1)):
                    y, x = i + di, j + dj
                    if 0 <= y < rows and 0 <= x < columns and labels[y, x] == 0 and height_mm[y, x] > floor_mm:
                        edge = True
                if edge:
                    front[size] = i * columns + j
                    size += 1
    for step in range(steps):
        grown = 0
        for index in range(size):
            i, j = front[index] // columns, front[index] % columns
            for di in range(-1, 2):
                for dj in range(-1, 2):
                    if step % 2 == 1 and di and dj:
                        continue
                    y, x = i + di, j + dj
                    if 0 <= y < rows and 0 <= x < columns and labels[y, x] == 0 and height_mm[y, x] > floor_mm:
                        labels[y, x] = labels[i, j]
                        fresh[grown] = y * columns + x
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
