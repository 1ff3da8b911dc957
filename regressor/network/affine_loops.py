"""What `regressor.network.affine` does between its products, as plain loops that LLVM vectorises.

Throughout, unit w of neighbour k is at centroid c the sum of rows[r, w] * basis[r, c] over the rows r of neighbour k,
which are those from begin[k] up to begin[k + 1]. `rows` is (R, W), `basis` (R, C), both float32, `begin` (K + 1,).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel
from regressor.network.products import Array


@kernel(nogil=True)
def behind_relu(rows: Array, basis: Array, begin: NDArray[np.int64]) -> tuple[Array, Array, NDArray[np.int64]]:
    """(rows, basis, begin) of the units behind a ReLU.

    A unit that is awake for all centroids keeps its coefficients, one that is asleep for all has none. One that is
    neither gets a row of its own, with its values for basis.
    """
    width, centroids = rows.shape[1], basis.shape[1]
    neighbours = len(begin) - 1
    low, high = np.empty((neighbours, width), np.float32), np.empty((neighbours, width), np.float32)
    begin_out = np.empty_like(begin)
    begin_out[0] = 0
    for k in range(neighbours):
        bounds(rows, basis, (begin[k], begin[k + 1]), low[k], high[k])
        changing = 0
        for w in range(width):
            changing += low[k, w] <= 0 and high[k, w] > 0
        begin_out[k + 1] = begin_out[k] + begin[k + 1] - begin[k] + changing
    total = begin_out[neighbours]
    rows_out, basis_out = np.zeros((total, width), np.float32), np.empty((total, centroids), np.float32)
    for k in range(neighbours):
        at = begin_out[k]
        for r in range(begin[k], begin[k + 1]):
            basis_out[at] = basis[r]
            for w in range(width):
                rows_out[at, w] = rows[r, w] if low[k, w] > 0 else np.float32(0)
            at += 1
        for w in range(width):
            if low[k, w] <= 0 and high[k, w] > 0:
                values = basis_out[at]
                unit_values(rows, basis, (begin[k], begin[k + 1]), w, values)
                for c in range(centroids):
                    values[c] = values[c] if values[c] > 0 else np.float32(0)
                rows_out[at, w] = np.float32(1)
                at += 1
    return rows_out, basis_out, begin_out


@kernel(nogil=True)
def largest(rows: Array, basis: Array, begin: NDArray[np.int64]) -> Array:
    """(C, W): the largest value over the neighbours. Only those that may hold it, by their bounds, are evaluated."""
    width, centroids = rows.shape[1], basis.shape[1]
    neighbours = len(begin) - 1
    low, high = np.empty(width, np.float32), np.empty((neighbours, width), np.float32)
    floor = np.full(width, -np.inf, np.float32)
    for k in range(neighbours):
        bounds(rows, basis, (begin[k], begin[k + 1]), low, high[k])
        for w in range(width):
            floor[w] = low[w] if low[w] > floor[w] else floor[w]
    out = np.full((width, centroids), -np.inf, np.float32)
    values = np.empty(centroids, np.float32)
    for k in range(neighbours):
        for w in range(width):
            if high[k, w] >= floor[w]:
                unit_values(rows, basis, (begin[k], begin[k + 1]), w, values)
                for c in range(centroids):
                    out[w, c] = values[c] if values[c] > out[w, c] else out[w, c]
    return out.T


@kernel(nogil=True)
def bounds(rows: Array, basis: Array, of: tuple[int, int], low: Array, high: Array) -> None:
    """Into `low` and `high` (W,): what the units of one neighbour, rows `of`, are no less and no more than."""
    low[:] = np.float32(0)
    high[:] = np.float32(0)
    for r in range(of[0], of[1]):
        least, most = basis[r, 0], basis[r, 0]
        for c in range(basis.shape[1]):
            least = basis[r, c] if basis[r, c] < least else least
            most = basis[r, c] if basis[r, c] > most else most
        for w in range(rows.shape[1]):
            a, b = rows[r, w] * least, rows[r, w] * most
            low[w] += a if a < b else b
            high[w] += b if a < b else a


@kernel(nogil=True)
def unit_values(rows: Array, basis: Array, of: tuple[int, int], unit: int, out: Array) -> None:
    """Into `out` (C,): what one unit of one neighbour, rows `of`, is at each centroid."""
    first = of[0]
    for c in range(len(out)):
        out[c] = rows[first, unit] * basis[first, c]
    for r in range(first + 1, of[1]):
        share = rows[r, unit]
        for c in range(len(out)):
            out[c] += share * basis[r, c]
