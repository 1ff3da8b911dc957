"""Who belongs to whom at the least cost in all: shortest augmenting paths, a row after the other.

Source: Crouse 2016, "On implementing 2D rectangular assignment algorithms", as SciPy's `linear_sum_assignment` has it;
ties fall as they fall there. Its package takes a third of a second to import, as long as all of a segmenter's kernels.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel


def least_cost_pairs(cost: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Pairs (row, column) of a (n, m) cost matrix, finite, rows in order; as many as its shorter side has."""
    if not cost.size:
        return []
    if cost.shape[0] <= cost.shape[1]:
        return list(enumerate(_columns_of_rows(np.ascontiguousarray(cost, np.float64)).tolist()))
    rows = _columns_of_rows(np.ascontiguousarray(cost.T, np.float64)).tolist()
    return sorted((row, column) for column, row in enumerate(rows))


@kernel()
def _columns_of_rows(cost: NDArray[np.float64]) -> NDArray[np.int64]:
    """(n,) the column of each row of a (n, m) matrix, n at most m."""
    rows, columns = cost.shape
    row_price, column_price = np.zeros(rows), np.zeros(columns)
    column_of, row_of = np.full(rows, -1, np.int64), np.full(columns, -1, np.int64)
    path, shortest, remaining = np.empty(columns, np.int64), np.empty(columns), np.empty(columns, np.int64)
    row_seen, column_seen = np.empty(rows, np.bool_), np.empty(columns, np.bool_)
    for first in range(rows):
        shortest[:] = np.inf
        path[:] = -1
        row_seen[:] = False
        column_seen[:] = False
        left = columns
        for k in range(columns):
            remaining[k] = columns - k - 1
        row, sink, reached = first, -1, 0.0
        while sink == -1:
            row_seen[row] = True
            lowest, best = np.inf, 0
            for k in range(left):
                column = remaining[k]
                way = reached + cost[row, column] - row_price[row] - column_price[column]
                if way < shortest[column]:
                    path[column], shortest[column] = row, way
                if shortest[column] < lowest or (shortest[column] == lowest and row_of[column] == -1):
                    lowest, best = shortest[column], k
            reached, column = lowest, remaining[best]
            if row_of[column] == -1:
                sink = column
            else:
                row = row_of[column]
            column_seen[column] = True
            left -= 1
            remaining[best] = remaining[left]
        for k in range(rows):
            if k == first:
                row_price[k] += reached
            elif row_seen[k]:
                row_price[k] += reached - shortest[column_of[k]]
        for k in range(columns):
            if column_seen[k]:
                column_price[k] -= reached - shortest[k]
        column = sink
        while True:
            row = path[column]
            row_of[column] = row
            column_of[row], column = column, column_of[row]
            if row == first:
                break
    return column_of
