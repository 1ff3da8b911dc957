"""Labels of a mask that lie in several places: masks of 0 and 255, say, give one label to all that lies on a belt."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

APART_MM = 30.0
"""Of bare belt between two pieces of one label. Less takes a leaf across a tuber for belt, more misses tubers close to
each other."""
LEAST_PIECE_MM2 = 350.0
"""Of a piece that tells, as of the least tuber: a speck that was painted beside it does not."""


def labels_apart(labels: NDArray[Any], *, cell_mm: float) -> list[int]:
    """Labels of which two pieces or more have bare belt between them. What others hide in part may be seen in pieces,
    too, but no bare belt lies between those.

    Args:
        labels: (H, W) whole numbers, 0 = background.
        cell_mm: what a cell covers of the belt, each way.
    """
    side = 1 + 2 * round(APART_MM / 2 / cell_mm)
    inside = labels > 0
    count, islands = cv2.connectedComponents(cv2.dilate(inside.astype(np.uint8), np.ones((side, side), np.uint8)))
    if count < 3:  # the background, and one island
        return []
    pieces, cells = np.unique(labels[inside].astype(np.int64) * count + islands[inside], return_counts=True)
    names, places = np.unique(pieces[cells * cell_mm**2 >= LEAST_PIECE_MM2] // count, return_counts=True)
    return [int(name) for name in names[places > 1]]
