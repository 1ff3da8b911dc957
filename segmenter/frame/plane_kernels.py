"""Loops of the plane fit (`plane`): far samples, planes through three, their scores, trimmed fits, and heights."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from conveyor.kernels import kernel

LEAST_OF_CELL = 8
"""Samples that a coarse cell needs to stand for the belt."""


def triples_of(rng: Generator, n: int, count: int) -> NDArray[np.int64]:
    """(count, 3) int64: what so many calls of `rng.choice(n, 3, replace=False)` draw one after the other, in one call.

    Floyd's way of drawing three of n, and the shuffle of the three (NumPy 2's `Generator.choice`).
    """
    drawn = rng.integers(0, _highs(n, count), endpoint=True)
    return _shuffled(drawn.reshape(count, 5), n)


@lru_cache(maxsize=4)
def _highs(n: int, count: int) -> NDArray[np.int64]:
    return np.tile(np.array([n - 3, n - 2, n - 1, 2, 1]), count)


@kernel()
def _shuffled(drawn: NDArray[np.int64], n: int) -> NDArray[np.int64]:
    triples = np.empty((len(drawn), 3), np.int64)
    for k in range(len(drawn)):
        first = drawn[k, 0]
        second = n - 2 if drawn[k, 1] == first else drawn[k, 1]
        third = n - 1 if drawn[k, 2] == first or drawn[k, 2] == second else drawn[k, 2]
        triples[k, 0], triples[k, 1], triples[k, 2] = first, second, third
        for last in (2, 1):
            other = drawn[k, 5 - last]
            triples[k, other], triples[k, last] = triples[k, last], triples[k, other]
    return triples


@kernel(error_model="numpy")
def samples_of(
    grid: NDArray[np.uint16], scale_m: float, k: tuple[float, float, float, float], first: int, stride: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Normalised x, y and inverse depth of the pixels of a grid that have depth, row by row.

    Args:
        grid: every `stride`-th pixel of an image, both ways, from pixel `first` on. scale_m: metres per unit of depth.
        k: fx, fy, cx, cy of the image.
    """
    x, y, q, n = np.empty(grid.size), np.empty(grid.size), np.empty(grid.size), 0
    for row in range(grid.shape[0]):
        for column in range(grid.shape[1]):
            if grid[row, column] > 0:
                x[n] = (column * stride + first - k[2]) / k[0]
                y[n] = (row * stride + first - k[3]) / k[1]
                q[n] = 1.0 / (grid[row, column] * scale_m)
                n += 1
    return x[:n], y[:n], q[:n]


def far_samples(
    x: NDArray[np.float64], y: NDArray[np.float64], q: NDArray[np.float64], share: float
) -> NDArray[np.int64]:
    """Of each coarse cell, 0.1 wide in x/z and y/z, the sample that `share` of it lies farther away than.

    Args:
        x, y, q: (n,) normalised image coordinates and inverse depth, 1/metres.

    Returns:
        (k,) int64 indices, cell after cell; cells with fewer than `LEAST_OF_CELL` samples have none.
    """
    return _far(*_cells(x, y), q, share)


@kernel()
def _cells(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[NDArray[np.int64], int]:
    """(n,) coarse cell of each sample, column after column, and how many cells there are."""
    column, row = np.empty(len(x), np.int64), np.empty(len(x), np.int64)
    for n in range(len(x)):
        column[n], row[n] = np.int64(np.rint(x[n] * 10)), np.int64(np.rint(y[n] * 10))
    rows = row.max() - row.min() + 1
    return (column - column.min()) * rows + (row - row.min()), (column.max() - column.min() + 1) * rows


@kernel()
def _far(cell: NDArray[np.int64], cells: int, q: NDArray[np.float64], share: float) -> NDArray[np.int64]:
    ends = np.zeros(cells + 1, np.int64)
    for n in range(len(cell)):
        ends[cell[n] + 1] += 1
    ends = np.cumsum(ends)
    members, at = np.empty(len(cell), np.int64), ends.copy()
    for n in range(len(cell)):
        members[at[cell[n]]] = n
        at[cell[n]] += 1
    far, low, found = np.empty(cells, np.int64), np.empty(len(cell), np.int64), 0
    for k in range(cells):
        count = ends[k + 1] - ends[k]
        if count >= LEAST_OF_CELL:
            # Only so many of the farthest are kept in order, of equal ones the first first.
            wanted, kept = int(count * share) + 1, 0
            for n in range(ends[k], ends[k + 1]):
                value = q[members[n]]
                if kept == wanted:
                    if value >= q[low[kept - 1]]:
                        continue
                    kept -= 1
                place = kept
                while place > 0 and q[low[place - 1]] > value:
                    low[place] = low[place - 1]
                    place -= 1
                low[place] = members[n]
                kept += 1
            far[found] = low[wanted - 1]
            found += 1
    return far[:found]


@kernel()
def planes_through(
    triples: NDArray[np.int64], x: NDArray[np.float64], y: NDArray[np.float64], q: NDArray[np.float64], clear: float
) -> NDArray[np.float64]:
    """(k, 3) the planes through three samples each, in the order of `triples`; three nearly in a line fix none.

    Args:
        clear: twice the area, in normalised image coordinates, that three samples have to span.
    """
    planes, found = np.empty((len(triples), 3)), 0
    for k in range(len(triples)):
        first, second, third = triples[k]
        ux, uy, uq = x[second] - x[first], y[second] - y[first], q[second] - q[first]
        vx, vy, vq = x[third] - x[first], y[third] - y[first], q[third] - q[first]
        span = ux * vy - uy * vx
        if abs(span) >= clear:
            a, b = (uq * vy - uy * vq) / span, (ux * vq - uq * vx) / span
            planes[found, 0], planes[found, 1], planes[found, 2] = a, b, q[first] - a * x[first] - b * y[first]
            found += 1
    return planes[:found]


@kernel(error_model="numpy")
def heights_over(
    plane: NDArray[np.float64], x: NDArray[np.float64], y: NDArray[np.float64], q: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(n,) distance of each sample over a plane, towards the camera, metres."""
    a, b, c = plane
    per_norm = 1.0 / np.sqrt(a * a + b * b + c * c)
    heights = np.empty(len(q))
    for n in range(len(q)):
        heights[n] = (1.0 - (x[n] * a + y[n] * b + c) / q[n]) * per_norm
    return heights


@kernel()
def support(heights: NDArray[np.float64], band_m: float) -> tuple[int, float]:
    """How many samples lie within `band_m` of their plane, and the sum of their squared heights, m2."""
    count, squares = 0, 0.0
    for height in heights:
        if abs(height) < band_m:
            count += 1
            squares += height * height
    return count, squares


@kernel()
def row_means(
    along: NDArray[np.float64], height: NDArray[np.float64], band_m: float, fewest: int
) -> NDArray[np.float64]:
    """(k,) mean height of each row of samples, of those within `band_m` of the plane, where there are `fewest` of them.

    Args:
        along: (n,) y of each sample, row after row. height: (n,) over the plane, metres.
    """
    means, found = np.empty(len(along)), 0
    total, count, row = 0.0, 0, 0.0
    for n in range(len(along)):
        if not abs(height[n]) < band_m:
            continue
        if count > 0 and along[n] != row:
            if count >= fewest:
                means[found] = total / count
                found += 1
            total, count = 0.0, 0
        row = along[n]
        total += height[n]
        count += 1
    if count >= fewest:
        means[found] = total / count
        found += 1
    return means[:found]


def quantile(values: NDArray[np.float64], share: float) -> float:
    """As `np.quantile` finds it, rounding included, without what that does around it."""
    ordered = np.sort(values)
    at = share * (len(ordered) - 1)
    below = int(at)
    low, high, part = float(ordered[below]), float(ordered[min(below + 1, len(ordered) - 1)]), at - below
    return high - (high - low) * (1.0 - part) if part >= 0.5 else low + (high - low) * part


@kernel()
def best_plane(
    planes: NDArray[np.float64],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    q: NDArray[np.float64],
    band_m: float,
    below_m: float,
) -> int:
    """The first of (k, 3) planes with the most samples within `band_m` of it less those more than `below_m` below it;
    -1 without any.
    """
    best, best_score = -1, np.int64(-len(q) - 1)
    for k in range(len(planes)):
        a, b, c = planes[k]
        norm = np.sqrt(a * a + b * b + c * c)
        # A sample's height over the plane is (q - plane) / q / norm: compared without dividing, for q is above 0.
        band, below, score = band_m * norm, below_m * norm, np.int64(0)
        for n in range(len(q)):
            over = q[n] - (x[n] * a + y[n] * b + c)
            score += np.int64(abs(over) < band * q[n]) - np.int64(-over > below * q[n])
        if score > best_score:
            best, best_score = k, score
    return best


@kernel()
def trimmed(
    plane: NDArray[np.float64],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    q: NDArray[np.float64],
    bands_m: tuple[float, ...],
    fewest: int,
) -> NDArray[np.float64]:
    """(3,) the plane after a least-squares fit to what lies within each of the bands of the one before; zeros where
    fewer than `fewest` samples do.

    The three normal equations are centred on the samples' mean, so that they lose nothing against a fit by SVD.
    """
    a, b, c = plane
    for band_m in bands_m:
        band = band_m * np.sqrt(a * a + b * b + c * c)
        count, mean_x, mean_y, mean_q = 0, 0.0, 0.0, 0.0
        near = np.empty(len(q), np.bool_)
        for n in range(len(q)):
            near[n] = abs(q[n] - (x[n] * a + y[n] * b + c)) < band * q[n]
            if near[n]:
                count += 1
                mean_x += x[n]
                mean_y += y[n]
                mean_q += q[n]
        if count < fewest:
            return np.zeros(3)
        mean_x, mean_y, mean_q = mean_x / count, mean_y / count, mean_q / count
        xx, xy, yy, xq, yq = 0.0, 0.0, 0.0, 0.0, 0.0
        for n in range(len(q)):
            if near[n]:
                dx, dy, dq = x[n] - mean_x, y[n] - mean_y, q[n] - mean_q
                xx += dx * dx
                xy += dx * dy
                yy += dy * dy
                xq += dx * dq
                yq += dy * dq
        determinant = xx * yy - xy * xy
        if determinant <= 0.0:  # all on one line: they fix no plane
            return np.zeros(3)
        a, b = (xq * yy - yq * xy) / determinant, (yq * xx - xq * xy) / determinant
        c = mean_q - a * mean_x - b * mean_y
    return np.array([a, b, c])
