"""Marks along a row of cells, and where they are: kernels set them without a branch, several cells at once, and then
look at the few marked cells one by one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel

WORD = 8
"""So many marks of one byte are looked at as one word."""


@kernel()
def row_of_marks(columns: int) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
    """((n,) uint8 marks of a row of cells, none set, n a whole number of words; (n,) int32 room for their places)."""
    padded = -(-columns // WORD) * WORD
    return np.zeros(padded, np.uint8), np.empty(padded, np.int32)


@kernel()
def marked(marks: NDArray[np.uint8], room: NDArray[np.int32]) -> NDArray[np.int32]:
    """Places of the marks that are set, rising, in `room`. What lies behind the row's last cell must be 0."""
    words = marks.view(np.uint64)
    count = 0
    for n in range(len(words)):
        if words[n] != 0:
            for j in range(n * WORD, n * WORD + WORD):
                room[count] = j
                count += marks[j] != 0
    return room[:count]
