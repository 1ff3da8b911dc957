"""Whether given masks tell tubers apart. Looks on; changes no count."""

from __future__ import annotations

import cv2
import numpy as np

from segmenter.frame.constants import APART_MM, LEAST_PIECE_MM2
from segmenter.frame.instances import Instances


class MaskWatch:
    """Masks of 0 and 255, say, give one label to all that lies on the belt, and a view then shows no single tuber.

    Attributes:
        merged: frames in which a label lies in two places or more with bare belt between them.
    """

    def __init__(self) -> None:
        self.merged = 0

    def step(self, instances: Instances, *, cell_mm: float) -> None:
        """Take the instances that the masks of one more frame give."""
        self.merged += _lies_apart(instances, cell_mm)


def _lies_apart(instances: Instances, cell_mm: float) -> bool:
    """A tuber that others hide in part may be seen in several pieces, but no bare belt lies between these."""
    labels = instances.labels
    side = 1 + 2 * round(APART_MM / 2 / cell_mm)
    widened = cv2.dilate((labels > 0).astype(np.uint8), np.ones((side, side), np.uint8))
    n, islands = cv2.connectedComponents(widened)
    cells = np.bincount((labels * n + islands).ravel(), minlength=(len(instances) + 1) * n).reshape(-1, n)
    return bool((np.count_nonzero(cells[1:] * cell_mm**2 >= LEAST_PIECE_MM2, axis=1) > 1).any())
