"""Where the view really ends: a stereo camera measures nothing in a band along its left border; a tuber that reaches
into that band is cut there although it does not touch the image's border.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel


@kernel()
def cut_by_unseen(labels: NDArray[np.int32], n: int, seen: NDArray[np.uint8], reach: int) -> NDArray[np.int64]:
    """How many rows or columns of each label lie first or last of all that was seen.

    Args:
        labels: (h, w) int32, 0 = none, otherwise 1..n.
        n: number of labels.
        seen: (h, w) uint8, 1 where the camera measured.
        reach: cells between a label and the end of what was seen that still count as touching.

    Returns:
        (n + 1, 4) int64: columns at the top and bottom end, rows at the left and right end.
    """
    rows, columns = labels.shape
    touching = np.zeros((n + 1, 4), np.int64)
    for i in range(rows):
        first, last = 0, columns - 1
        while first < columns and not seen[i, first]:
            first += 1
        while last >= 0 and not seen[i, last]:
            last -= 1
        if last >= 0:
            _note(labels[i, first : min(first + reach + 1, columns)], touching[:, 2])
            _note(labels[i, max(last - reach, 0) : last + 1], touching[:, 3])
    # Column by column, but read row by row, as the cells lie in the memory.
    first_of, last_of = np.full(columns, rows, np.int32), np.full(columns, -1, np.int32)
    for i in range(rows):
        here, row = seen[i], np.int32(i)
        for j in range(columns):  # without a branch, so that the compiler takes several cells at once
            first_of[j] = row if (here[j] != 0) & (last_of[j] < 0) else first_of[j]
            last_of[j] = row if here[j] != 0 else last_of[j]
    for j in range(columns):
        first, last = first_of[j], last_of[j]
        if last >= 0:
            _note(labels[first : min(first + reach + 1, rows), j], touching[:, 0])
            _note(labels[max(last - reach, 0) : last + 1, j], touching[:, 1])
    return touching


@kernel()
def _note(cells: NDArray[np.int32], touching: NDArray[np.int64]) -> None:
    """Count the first label among a few cells, once."""
    for label in cells:
        if label > 0:
            touching[label] += 1
            return
