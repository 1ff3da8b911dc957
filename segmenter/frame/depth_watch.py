"""How much of the picture shows no depth: dirt on the glass, glare, or nothing within reach. Changes no count."""

from __future__ import annotations

from collections import deque
from statistics import median

import numpy as np
from numpy.typing import NDArray

from conveyor.messages import Frame
from segmenter.frame.constants import HOLE_PX, HOLE_SEEN, HOLES_TOLD, KEPT_CHECKS, LOOK_EVERY


def share_without_depth(depth: NDArray[np.uint16]) -> float:
    """Share of the squares of a picture (rows, columns) that show no depth. Holes at outlines, noise and a camera that
    tells every other row leave depth in most of them; dirt does not.
    """
    rows, columns = (size // HOLE_PX for size in depth.shape)
    squares = depth[: rows * HOLE_PX, : columns * HOLE_PX].reshape(rows, HOLE_PX, columns, HOLE_PX)
    return float((np.count_nonzero(squares, axis=(1, 3)) < HOLE_SEEN * HOLE_PX**2).mean())


class DepthWatch:
    """Looks at processed frames by their count."""

    def __init__(self) -> None:
        self._frames = 0
        self._empty: deque[float] = deque(maxlen=KEPT_CHECKS)

    def step(self, frame: Frame) -> None:
        """Take the next processed frame. One with masks may be cut out of its picture."""
        if self._frames % LOOK_EVERY == 0 and frame.mask is None:
            self._empty.append(share_without_depth(frame.depth))
        self._frames += 1

    @property
    def without_depth(self) -> float:
        """Share of the picture without depth, the median of the last looks, where it is so much that tubers are lost;
        else 0.
        """
        if len(self._empty) < KEPT_CHECKS:
            return 0.0
        share = median(self._empty)
        return share if share >= HOLES_TOLD else 0.0
