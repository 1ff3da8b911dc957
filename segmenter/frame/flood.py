"""Numba kernels of the splitter: descending flood with dynamics, and regrowth."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

LEVEL_MM = 0.25
"""Millimetres of relief per level of the counting sort: finer than any dynamics that matter."""
MOST_LEVELS = 65535
"""16 m of relief: what is higher is flooded as if it were as high."""
RELIEF, PEAK = 0, 1
"""Columns of a node. Its relief stands there as its float32 bits, which order as the heights do where none is negative:
so all that is asked of a neighbour lies in one place of the memory. Its peak is a row of the table of peaks, -1 before
it is flooded; few peaks are found, so that their table stays in the cache."""


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def _find(parents: NDArray[np.int32], peak: Any) -> Any:
    while parents[peak] != peak:
        parents[peak] = parents[parents[peak]]
        peak = parents[peak]
    return peak


def flood(
    relief_mm: NDArray[np.float32], foreground: NDArray[np.uint8], least_mm: float, share: float
) -> tuple[NDArray[np.int32], int]:
    """Basins of a relief, flooded from its peaks downwards.

    Two basins that meet become one when the lower peak rises less than max(`least_mm`, `share` * its own height) over
    the pass between them; this replaces h-maxima and a watershed by one pass over the cells in falling order. Basins of
    two patches that do not touch never meet, so patch after patch is flooded: what belongs together stays in the cache.

    Args:
        relief_mm: (h, w) float32, high inside tubers.
        foreground: (h, w) uint8, cells to label.
        least_mm, share: the dynamics a peak needs.

    Returns:
        ((h, w) int32 labels 1..n, 0 elsewhere; n)
    """
    patches, patch = cv2.connectedComponents(foreground, connectivity=8, ltype=cv2.CV_32S)
    return _flood(relief_mm, np.asarray(patch, np.int32), patches, least_mm, share)


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def _level(relief_mm: Any) -> Any:
    return min(max(0, int(relief_mm / LEVEL_MM)) + 1, MOST_LEVELS)


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def _falling(cells: NDArray[np.int32], levels: NDArray[np.uint16], counts: NDArray[np.int64]) -> NDArray[np.int32]:
    """The cells of a patch, highest level first, in their order within a level: a counting sort. `counts`: zeros."""
    low, high = np.int64(MOST_LEVELS), np.int64(0)
    for level in levels:
        counts[level] += 1
        low, high = min(low, np.int64(level)), max(high, np.int64(level))
    before = 0
    for level in range(high, low - 1, -1):
        before, counts[level] = before + counts[level], before
    order = np.empty_like(cells)
    for n in range(len(cells)):
        order[counts[levels[n]]] = cells[n]
        counts[levels[n]] += 1
    counts[low : high + 1] = 0
    return order


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def _named(
    nodes: NDArray[np.int32], peaks: NDArray[np.int32], parents: NDArray[np.int32], patch: NDArray[np.int32]
) -> tuple[NDArray[np.int32], int]:
    """Number the basins 1..n, highest peak first, without the rim of one cell that `_flood` works with.

    The first cell of a basin was a peak, so that the peaks alone, in falling order, tell the order of the basins.
    """
    rows, columns = patch.shape
    width = columns + 2
    labels = np.zeros((rows, columns), np.int32)
    relief = nodes.view(np.float32)
    falling = np.empty(len(peaks), np.int64)
    for k in range(len(peaks)):
        falling[k] = -np.int64(_level(relief[peaks[k], RELIEF])) * len(nodes) + peaks[k]
    names = np.zeros(len(peaks), np.int32)
    n = 0
    for k in np.argsort(falling):
        root = _find(parents, k)
        if names[root] == 0:
            n += 1
            names[root] = n
    for k in range(len(peaks)):
        names[k] = names[_find(parents, k)]
    for i in range(rows):
        for j in range(columns):
            if patch[i, j]:
                labels[i, j] = names[nodes[(i + 1) * width + j + 1, PEAK]]
    return labels, n


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def _flood(
    relief_mm: NDArray[np.float32], patch: NDArray[np.int32], patches: int, least_mm: float, share: float
) -> tuple[NDArray[np.int32], int]:
    """See `flood`; `patch`: (h, w) which of the `patches` that do not touch a cell belongs to, 0 = background."""
    # A rim of one cell around the image, so that no neighbour needs a check of the border.
    rows, columns = relief_mm.shape
    width = columns + 2
    nodes = np.full(((rows + 2) * width, 2), np.int32(-1), np.int32)
    relief = nodes.view(np.float32)
    ends = np.zeros(patches + 1, np.int64)
    for i in range(rows):
        for j in range(columns):
            ends[patch[i, j] + 1] += 1
    ends[1] = 0
    ends = np.cumsum(ends)
    cells = np.empty(ends[patches], np.int32)
    levels = np.empty(ends[patches], np.uint16)
    for i in range(rows):
        for j in range(columns):
            if patch[i, j]:
                cell = (i + 1) * width + j + 1
                relief[cell, RELIEF] = relief_mm[i, j]
                cells[ends[patch[i, j]]] = cell
                levels[ends[patch[i, j]]] = _level(relief_mm[i, j])
                ends[patch[i, j]] += 1
    counts = np.zeros(MOST_LEVELS + 1, np.int64)
    peaks, parents = np.empty(len(cells), np.int32), np.empty(len(cells), np.int32)
    found, begin = 0, 0
    for k in range(1, patches):
        order = _falling(cells[begin : ends[k]], levels[begin : ends[k]], counts)
        found = _flood_patch(nodes, order, width, least_mm, share, peaks, parents, found)
        begin = ends[k]
    return _named(nodes, peaks[:found], parents[:found], patch)


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def _flood_patch(
    nodes: NDArray[np.int32],
    order: NDArray[np.int32],
    width: int,
    least_mm: float,
    share: float,
    peaks: NDArray[np.int32],
    parents: NDArray[np.int32],
    found: int,
) -> int:
    """Flood the cells of a patch in their falling order; returns how many peaks there are then.

    Args:
        peaks: cell of each peak, written from `found` on.
        parents: union-find forest over the peaks; a root is the highest peak of its basin.
    """
    relief = nodes.view(np.float32)
    for cell in order:
        # The cell joins the basin of its highest flooded neighbour; without one it is a peak of its own.
        home, highest, first, meet = np.int32(-1), np.int32(-1), np.int32(-1), False
        for step in (-width - 1, -width, -width + 1, -1, 1, width - 1, width, width + 1):
            near = cell + step
            peak = nodes[near, PEAK]
            if peak >= 0:
                if nodes[near, RELIEF] > highest:
                    highest = nodes[near, RELIEF]
                    home = peak
                meet |= first >= 0 and peak != first
                first = peak
        if home < 0:
            nodes[cell, PEAK] = parents[found] = found
            peaks[found] = cell
            found += 1
            continue
        root = _find(parents, home)
        nodes[cell, PEAK] = root
        if not meet:
            continue
        # Where it touches other basins it is the pass between them: the highest, for cells come in falling order.
        for step in (-width - 1, -width, -width + 1, -1, 1, width - 1, width, width + 1):
            peak = nodes[cell + step, PEAK]
            if peak >= 0 and peak != root:
                other = _find(parents, peak)
                if other != root:
                    lower = nodes[peaks[other], RELIEF] < nodes[peaks[root], RELIEF]
                    low, high = (other, root) if lower else (root, other)
                    top = relief[peaks[low], RELIEF]
                    # The lower peak hardly rises over the pass: no tuber of its own.
                    if top - relief[cell, RELIEF] < max(least_mm, share * top):
                        parents[low] = high
                        root = high
    return found


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
