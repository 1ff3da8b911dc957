"""Loops of the plane fit (`plane`): the far samples, the score of many planes, and successive trimmed fits."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.random import Generator
from numpy.typing import NDArray

LEAST_OF_CELL = 8
"""Samples that a coarse cell needs to stand for the belt."""


def triples_of(rng: Generator, n: int, count: int) -> NDArray[np.int64]:
    """(count, 3) int64: what so many calls of `rng.choice(n, 3, replace=False)` draw one after the other, in one call.

    Floyd's way of drawing three of n, and the shuffle of the three (NumPy 2's `Generator.choice`).
    """
    drawn = rng.integers(0, np.tile(np.array([n - 3, n - 2, n - 1, 2, 1]), count), endpoint=True).reshape(count, 5)
    first = drawn[:, 0]
    second = np.where(drawn[:, 1] == first, n - 2, drawn[:, 1])
    third = np.where((drawn[:, 2] == first) | (drawn[:, 2] == second), n - 1, drawn[:, 2])
    triples, rows = np.stack([first, second, third], axis=1), np.arange(count)
    for last, other in ((2, drawn[:, 3]), (1, drawn[:, 4])):
        swapped = triples[rows, other]
        triples[rows, other] = triples[:, last]
        triples[:, last] = swapped
    return triples


def far_samples(
    x: NDArray[np.float64], y: NDArray[np.float64], q: NDArray[np.float64], share: float
) -> NDArray[np.int64]:
    """Of each coarse cell, 0.1 wide in x/z and y/z, the sample that `share` of it lies farther away than.

    Args:
        x, y, q: (n,) normalised image coordinates and inverse depth, 1/metres.

    Returns:
        (k,) int64 indices, cell after cell; cells with fewer than `LEAST_OF_CELL` samples have none.
    """
    column, row = np.rint(x * 10).astype(np.int64), np.rint(y * 10).astype(np.int64)
    rows = int(np.ptp(row)) + 1
    cell = (column - column.min()) * rows + (row - row.min())
    return _far(cell, (int(np.ptp(column)) + 1) * rows, q, share)


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def _far(cell: NDArray[np.int64], cells: int, q: NDArray[np.float64], share: float) -> NDArray[np.int64]:
    ends = np.zeros(cells + 1, np.int64)
    for n in range(len(cell)):
        ends[cell[n] + 1] += 1
    ends = np.cumsum(ends)
    members, at = np.empty(len(cell), np.int64), ends.copy()
    for n in range(len(cell)):
        members[at[cell[n]]] = n
        at[cell[n]] += 1
    far, found = np.empty(cells, np.int64), 0
    for k in range(cells):
        here = members[ends[k] : ends[k + 1]]
        if len(here) >= LEAST_OF_CELL:
            nearest_last = np.argsort(q[here], kind="mergesort")
            far[found] = here[nearest_last[int(len(here) * share)]]
            found += 1
    return far[:found]


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
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
    best, best_score = -1, -len(q) - 1
    for k in range(len(planes)):
        a, b, c = planes[k]
        norm = np.sqrt(a * a + b * b + c * c)
        # A sample's height over the plane is (q - plane) / q / norm: compared without dividing, for q is above 0.
        band, below, score = band_m * norm, below_m * norm, 0
        for n in range(len(q)):
            over = q[n] - (x[n] * a + y[n] * b + c)
            score += np.int64(abs(over) < band * q[n]) - np.int64(-over > below * q[n])
        if score > best_score:
            best, best_score = k, score
    return best


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
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
