"""Which way the belt runs through a camera's image, by the load alone: no pose, no encoder and no tracks are needed."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from segmenter.frame.constants import SHIFT_AREA, SHIFT_SAME_M

REACH_M = 0.15
"""Metres that the belt may move from frame to frame."""
STILL_M = 0.002
ENOUGH_M = 2.0
LEAST_ALIKE = 2
"""Instances that must move alike, where there are so many: one alone may be paired with another tuber."""
LEAST_M = 0.15
LEAST_MOVES = 8
"""Metres and moves: from there on the direction is known well, and below it is not known at all."""


@dataclass(slots=True)
class BeltDirection:
    """Adds up how the load moves, in the belt's plane with x along the image's +v.

    Attributes:
        moves_m: (2,) of each pair of frames that says one.
    """

    moves_m: list[NDArray[np.float64]] = field(default_factory=list)
    _before: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None

    def step(self, centre_m: NDArray[np.float64], area_m2: NDArray[np.float64]) -> None:
        """Take the instances of the next frame that no border cuts: (n, 2) centres, (n,) areas."""
        before, self._before = self._before, (centre_m, area_m2)
        if before is None:
            return
        move_m = common_move(*before, centre_m, area_m2, least=min(LEAST_ALIKE, len(before[0]), len(centre_m)))
        if move_m is not None and math.hypot(*move_m) > STILL_M:
            self.moves_m.append(move_m)

    @property
    def travelled_m(self) -> float:
        """How far the load moved in all."""
        return math.hypot(*np.sum(self.moves_m, axis=0)) if self.moves_m else 0.0

    @property
    def known(self) -> bool:
        """Enough moved to say where to."""
        return len(self.moves_m) >= LEAST_MOVES and self.travelled_m >= LEAST_M

    @property
    def heading_deg(self) -> float:
        """From the image's downward direction to the travel, counter-clockwise as seen from above."""
        x_m, y_m = np.sum(self.moves_m, axis=0)
        return math.degrees(math.atan2(y_m, x_m))

    @property
    def heading_sd_deg(self) -> float:
        """Its standard error, by how the moves differ."""
        moves_m = np.array(self.moves_m)
        along = np.sum(moves_m, axis=0) / max(self.travelled_m, 1e-9)
        aside_m = moves_m @ np.array([-along[1], along[0]])
        return math.degrees(float(np.std(aside_m)) * math.sqrt(len(moves_m)) / max(self.travelled_m, 1e-9))


def heading_of(frames: Iterable[tuple[NDArray[np.float64], NDArray[np.float64]]]) -> BeltDirection:
    """The direction by frames of (centres, areas), until it is known well."""
    direction = BeltDirection()
    for centre_m, area_m2 in frames:
        direction.step(centre_m, area_m2)
        if direction.travelled_m >= ENOUGH_M:
            break
    return direction


def common_move(
    before_m: NDArray[np.float64],
    before_m2: NDArray[np.float64],
    after_m: NDArray[np.float64],
    after_m2: NDArray[np.float64],
    *,
    reach_m: tuple[float, float] = (REACH_M, REACH_M),
    least: int = 1,
) -> NDArray[np.float64] | None:
    """(2,) the move that most of a frame's instances share, metres; None where too few of them move alike.

    Args:
        before_m, after_m: (n, 2), (m, 2) centres; before_m2, after_m2: (n,), (m,) areas: those of one tuber are alike.
        reach_m: how far they may move along and across.
        least: instances that must move alike; half of them in any case.
    """
    move_m = after_m[None] - before_m[:, None]
    ratio = after_m2[None] / before_m2[:, None]
    alike = np.all(np.abs(move_m) < np.array(reach_m), axis=2) & (np.abs(np.log(ratio)) < SHIFT_AREA)
    moves_m = move_m[alike]
    least_alike = max(least, min(len(before_m), len(after_m)) / 2, 1)
    if len(moves_m) < least_alike:
        return None
    # The shortest first: of two that as many share it is taken.
    moves_m = moves_m[np.argsort(np.hypot(*moves_m.T), kind="stable")]
    near = np.all(np.abs(moves_m[:, None] - moves_m[None]) < SHIFT_SAME_M, axis=2)
    shared = near[int(near.sum(axis=1).argmax())]
    return np.asarray(np.median(moves_m[shared], axis=0)) if shared.sum() >= least_alike else None
