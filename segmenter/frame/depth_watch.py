"""How much of the picture shows no depth: dirt on the glass, glare, or nothing within reach. Changes no count."""

from __future__ import annotations

from collections import deque
from statistics import median

import numpy as np

from conveyor.messages import Frame
from segmenter.frame.constants import HOLE_PX, HOLE_SEEN, HOLES_TOLD, KEPT_CHECKS, LOOK_EVERY


class DepthWatch:
    """Looks at processed frames by their count. Holes at outlines, noise and a camera that tells every other row leave
    depth in most squares of the picture; dirt does not.
    """

    def __init__(self) -> None:
        self._frames = 0
        self._empty: deque[float] = deque(maxlen=KEPT_CHECKS)

    def step(self, frame: Frame) -> None:
        """Take the next processed frame. One with masks may be cut out of its picture."""
        if self._frames % LOOK_EVERY == 0 and frame.mask is None:
            rows, columns = (size // HOLE_PX for size in frame.depth.shape)
            squares = frame.depth[: rows * HOLE_PX, : columns * HOLE_PX].reshape(rows, HOLE_PX, columns, HOLE_PX)
            seen = np.count_nonzero(squares, axis=(1, 3))
            self._empty.append(float((seen < HOLE_SEEN * HOLE_PX**2).mean()))
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
