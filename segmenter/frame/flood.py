"""Numba kernels of the splitter: descending flood with dynamics, and regrowth."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel
from segmenter.frame.marks import marked, row_of_marks

LEVEL_MM = 0.25
"""Millimetres of relief per level of the counting sort: finer than any dynamics that matter."""
PER_MM = np.float32(1 / LEVEL_MM)
MOST_LEVELS = 65535
"""16 m of relief: what is higher is flooded as if it were as high."""
MOST_STEPS = np.float32(MOST_LEVELS - 1)
BACKGROUND = np.float32(-1)
"""Its relief; its level is 0."""


@kernel()
def _find(parents: NDArray[np.int32], peak: Any) -> Any:
    while parents[peak] != peak:
        parents[peak] = parents[parents[peak]]
        peak = parents[peak]
    return peak


@kernel()
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
    relief = _rimmed(relief_mm, foreground)
    width = relief_mm.shape[1] + 2
    basins, peaks = _basins(relief, width)
    parents = np.arange(len(peaks)).astype(np.int32)
    for cell in _falling(_between(basins, relief, width), relief):
        _meet(cell, basins, relief, width, peaks, parents, least_mm, share)
    return _named(basins, relief[peaks], peaks, parents, relief_mm.shape)


@kernel()
def _rimmed(relief_mm: NDArray[np.float32], foreground: NDArray[np.uint8]) -> NDArray[np.float32]:
    """((h + 2) * (w + 2),) the relief with a rim of background, so that no neighbour needs a check."""
    rows, columns = relief_mm.shape
    width = columns + 2
    relief = np.empty((rows + 2) * width, np.float32)
    relief[: width + 1] = BACKGROUND
    relief[len(relief) - width - 1 :] = BACKGROUND
    for i in range(rows):
        first = (i + 1) * width + 1
        own, given, wanted = relief[first : first + columns], relief_mm[i], foreground[i]
        for j in range(columns):  # without a branch, so that the compiler takes several cells at once
            own[j] = given[j] if wanted[j] else BACKGROUND
        relief[first + columns] = relief[first + columns + 1] = BACKGROUND
    return relief


@kernel()
def _level(relief_mm: Any) -> Any:
    """Its level, 0 for the background, at most `MOST_LEVELS`."""
    return np.int32(min(relief_mm * PER_MM, MOST_STEPS)) + 1 if relief_mm >= 0 else 0


@kernel()
def _around(width: int) -> Any:
    """Steps to the eight neighbours of a cell: four that come before it and four after."""
    return -width - 1, -width, -width + 1, -1, 1, width - 1, width, width + 1


@kernel()
def _neighbours(cells: NDArray[Any], first: int, width: int) -> Any:
    """The eight neighbours of a row's cells, the first of which is `first`, as eight views: four before, four after."""
    columns, above, below = width - 2, first - width, first + width
    return (
        cells[above - 1 : above - 1 + columns],
        cells[above : above + columns],
        cells[above + 1 : above + 1 + columns],
        cells[first - 1 : first - 1 + columns],
        cells[first + 1 : first + 1 + columns],
        cells[below - 1 : below - 1 + columns],
        cells[below : below + columns],
        cells[below + 1 : below + 1 + columns],
    )


@kernel()
def _basins(relief: NDArray[np.float32], width: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Before anything is merged: (cells,) -1 - the row of the peak that each leads up to, 0 in the background; (peaks,)
    their cells. Cells of one level come in the order of their rows and columns.
    """
    basins = np.zeros(len(relief), np.int32)
    peaks = np.empty(len(relief), np.int32)
    found = 0
    marks, room = row_of_marks(width - 2)
    steps = np.array(_around(width), np.int32)
    for first in range(width + 1, len(relief) - width, width):
        _point_up(relief, basins, first, width, steps, marks)
        for j in marked(marks, room):
            cell = first + j
            basins[cell] = _same_level_before(relief, cell, width)
            if basins[cell] == 0:
                peaks[found] = cell
                found += 1
                basins[cell] = -found
    for cell in range(len(relief)):
        if basins[cell] > 0:
            top = basins[basins[cell]]
            while top > 0:
                top = basins[top]
            step = cell
            while basins[step] > 0:
                basins[step], step = top, basins[step]
    return basins, peaks[:found]


@kernel()
def _point_up(
    relief: NDArray[np.float32],
    basins: NDArray[np.int32],
    first: int,
    width: int,
    steps: NDArray[np.int32],
    marks: NDArray[np.uint8],
) -> None:
    """Write for each cell of a row its highest neighbour, the first of equals, and mark the cells for which it is of no
    higher level: it may come later than they do.

    Args:
        first: the row's first cell.
        steps: (8,) `_around`.
        marks: (w,) uint8, written.
    """
    a, b, c, d, e, f, g, h = _neighbours(relief, first, width)
    own_mm, own = relief[first : first + width - 2], basins[first : first + width - 2]
    # From an array, so that the compiler keeps them as short as heights are and takes as many of them at once.
    to_a, to_b, to_c, to_d, to_e, to_f, to_g, to_h = (
        steps[0], steps[1], steps[2], steps[3], steps[4], steps[5], steps[6], steps[7],
    )  # fmt: skip
    for j in range(width - 2):  # without a branch
        up, top = to_a, a[j]
        up, top = (to_b, b[j]) if b[j] > top else (up, top)
        up, top = (to_c, c[j]) if c[j] > top else (up, top)
        up, top = (to_d, d[j]) if d[j] > top else (up, top)
        up, top = (to_e, e[j]) if e[j] > top else (up, top)
        up, top = (to_f, f[j]) if f[j] > top else (up, top)
        up, top = (to_g, g[j]) if g[j] > top else (up, top)
        up, top = (to_h, h[j]) if h[j] > top else (up, top)
        labelled = own_mm[j] >= 0
        next_level = np.float32(np.int32(min(own_mm[j] * PER_MM, MOST_STEPS))) + np.float32(1)
        higher = min(top * PER_MM, MOST_STEPS) >= next_level
        own[j] = np.int32(first + j + up) if labelled & higher else np.int32(0)
        marks[j] = labelled & (not higher)


@kernel()
def _same_level_before(relief: NDArray[np.float32], cell: int, width: int) -> Any:
    """The highest of the neighbours before a cell that are of its level; 0 where none is."""
    level = _level(relief[cell])
    highest, up = BACKGROUND, 0
    for near in (cell - width - 1, cell - width, cell - width + 1, cell - 1):
        if relief[near] > highest and _level(relief[near]) == level:
            highest, up = relief[near], near
    return up


@kernel()
def _between(basins: NDArray[np.int32], relief: NDArray[np.float32], width: int) -> NDArray[np.int32]:
    """(n,) cells with a neighbour that comes before them and leads up to another peak than they do."""
    cells = np.empty(len(relief), np.int32)
    n = 0
    marks, room = row_of_marks(width - 2)
    for first in range(width + 1, len(relief) - width, width):
        _mark_borders(basins, first, width, marks)
        for j in marked(marks, room):
            cell = first + j
            met = False
            for step in _around(width):
                met = met or (basins[cell + step] != basins[cell] and _comes_before(relief, cell, step))
            if met:
                cells[n] = cell
                n += 1
    return cells[:n]


@kernel()
def _comes_before(relief: NDArray[np.float32], cell: int, step: int) -> Any:
    """Whether the neighbour of a cell that is a step away is flooded before it."""
    return _level(relief[cell + step]) >= _level(relief[cell]) + (step > 0)


@kernel()
def _mark_borders(basins: NDArray[np.int32], first: int, width: int, marks: NDArray[np.uint8]) -> None:
    """Mark the cells of a row that have a neighbour in another basin; the background is none."""
    a, b, c, d, e, f, g, h = _neighbours(basins, first, width)
    own = basins[first : first + width - 2]
    for j in range(width - 2):  # without a branch, so that the compiler takes several cells at once
        k = own[j]
        before = _differs(a[j], k) | _differs(b[j], k) | _differs(c[j], k) | _differs(d[j], k)
        after = _differs(e[j], k) | _differs(f[j], k) | _differs(g[j], k) | _differs(h[j], k)
        marks[j] = (k != 0) & (before | after)


@kernel()
def _differs(near: Any, own: Any) -> Any:
    return (near != own) & (near != 0)


@kernel()
def _falling(cells: NDArray[np.int32], relief: NDArray[np.float32]) -> NDArray[np.int32]:
    """The cells, highest level first, in their order within a level: a counting sort."""
    levels = np.empty(len(cells), np.int64)
    highest = 0
    for n in range(len(cells)):
        levels[n] = _level(relief[cells[n]])
        highest = max(highest, levels[n])
    counts = np.zeros(highest + 1, np.int64)
    for n in range(len(cells)):
        counts[levels[n]] += 1
    before = 0
    for level in range(highest, -1, -1):
        before, counts[level] = before + counts[level], before
    order = np.empty_like(cells)
    for n in range(len(cells)):
        order[counts[levels[n]]] = cells[n]
        counts[levels[n]] += 1
    return order


@kernel()
def _meet(
    cell: int,
    basins: NDArray[np.int32],
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
    for step in _around(width):
        if _comes_before(relief, cell, step):
            other = _find(parents, -1 - basins[cell + step])
            if other != root:
                low, high = (other, root) if relief[peaks[other]] < relief[peaks[root]] else (root, other)
                top = relief[peaks[low]]
                # The lower peak hardly rises over the pass: no tuber of its own.
                if top - relief[cell] < max(least_mm, share * top):
                    parents[low] = high
                    root = high


@kernel()
def _named(
    basins: NDArray[np.int32],
    peaks_mm: NDArray[np.float32],
    peaks: NDArray[np.int32],
    parents: NDArray[np.int32],
    shape: tuple[int, int],
) -> tuple[NDArray[np.int32], int]:
    """Number the basins 1..n, highest peak first, without the rim."""
    falling = np.empty(len(peaks), np.int64)
    for k in range(len(peaks)):
        falling[k] = -np.int64(_level(peaks_mm[k])) * len(basins) + peaks[k]
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
        first = (i + 1) * (columns + 2) + 1
        own, basin = labels[i], basins[first : first + columns]
        for j in range(columns):
            own[j] = names[np.uint32(-basin[j])]
    return labels, n


@kernel()
def regrow(labels: NDArray[np.int32], height_mm: NDArray[np.float32], floor_mm: float, steps: int) -> None:
    """Grow all labels ring by ring, in place, into unlabelled cells higher than `floor_mm`, at most `steps` cells.

    The first ring grows around corners, the second does not, and so on.
    """
    columns = labels.shape[1]
    flat, bare = labels.reshape(-1), _bare(labels, height_mm, np.float32(floor_mm))
    front, rimmed, size = _beside_bare(labels, bare)
    fresh, fresh_rimmed = np.empty_like(front), np.empty_like(front)
    around, around_rimmed = np.array(_around(columns)), np.array(_around(columns + 2))
    straight, all_ways = np.array([1, 3, 4, 6]), np.arange(8)
    for step in range(steps):
        grown = 0
        ways = all_ways if step % 2 == 0 else straight
        for index in range(size):
            for way in ways:
                near = rimmed[index] + around_rimmed[way]
                if bare[near]:
                    bare[near] = 0
                    fresh[grown], fresh_rimmed[grown] = front[index] + around[way], near
                    flat[fresh[grown]] = flat[front[index]]
                    grown += 1
        front, fresh, rimmed, fresh_rimmed, size = fresh, front, fresh_rimmed, rimmed, grown


@kernel()
def _bare(labels: NDArray[np.int32], height_mm: NDArray[np.float32], floor_mm: Any) -> NDArray[np.uint8]:
    """((h + 2) * (w + 2),) 1 where a cell has no label and is higher than `floor_mm`; with a rim of 0."""
    rows, columns = labels.shape
    bare = np.zeros((rows + 2) * (columns + 2), np.uint8)
    for i in range(rows):
        first = (i + 1) * (columns + 2) + 1
        own, label, high = bare[first : first + columns], labels[i], height_mm[i]
        for j in range(columns):  # without a branch, so that the compiler takes several cells at once
            own[j] = (label[j] == 0) & (high[j] > floor_mm)
    return bare


@kernel()
def _beside_bare(labels: NDArray[np.int32], bare: NDArray[np.uint8]) -> Any:
    """(cells,) labelled cells beside a bare one, as (n,) numbers without and with a rim; n."""
    rows, columns = labels.shape
    cells, rimmed = np.empty(rows * columns, np.int32), np.empty(rows * columns, np.int32)
    marks, room = row_of_marks(columns)
    size = 0
    for i in range(rows):
        first = (i + 1) * (columns + 2) + 1
        _a, above, _c, before, after, _f, below, _h = _neighbours(bare, first, columns + 2)
        label = labels[i]
        for j in range(columns):  # without a branch, so that the compiler takes several cells at once
            marks[j] = (label[j] > 0) & ((above[j] | below[j] | before[j] | after[j]) != 0)
        for j in marked(marks, room):
            cells[size], rimmed[size] = i * columns + j, first + j
            size += 1
    return cells, rimmed, size


@kernel()
def relabel(labels: NDArray[np.int32], names: NDArray[np.int32]) -> None:
    """Rename labels in place: label k becomes `names[k]`; `names[0]` is 0."""
    for i in range(labels.shape[0]):
        own = labels[i]
        for j in range(labels.shape[1]):
            own[j] = names[np.uint32(own[j])]
