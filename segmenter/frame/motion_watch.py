"""Whether the load moves as far as the encoder says, and the way that the camera's pose says. Changes no count.

An encoder that stands still, or that counts another number of pulses a metre, puts every tuber at several places or at
none; so does a camera that is turned against its pose. From one frame to the next all tubers move alike: the move that
most pairs of them share is how the belt moved.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from segmenter.frame.belt_direction import common_move
from segmenter.frame.constants import (
    COARSE_M,
    COARSE_STOOD,
    LEAST_STEP_M,
    SHIFT_ASIDE_M,
    SHIFT_KEPT,
    SHIFT_LEAST,
    SHIFT_LEAST_M,
    SHIFT_OFF,
    SHIFT_OFF_SHARE,
    TURNED_ALIKE,
    TURNED_DEG,
)
from segmenter.frame.instances import Instances

Places = NDArray[np.float64]


class MotionWatch:
    """The newest moves of the belt, as the tubers showed each and, with an encoder, as that told it; metres."""

    def __init__(self) -> None:
        self._moves: deque[tuple[float | None, float, float]] = deque(maxlen=SHIFT_KEPT)
        self._last: tuple[float | None, Places, Places] | None = None

    def step(self, instances: Instances, travel_m: float, *, told: bool) -> None:
        """Take one more frame: its instances, and the travel; `told`: by an encoder."""
        whole = ~instances.cut.any(axis=1)
        centre_m, area_m2 = instances.centre_m[whole], instances.area_m2[whole]
        last, self._last = self._last, (travel_m if told else None, centre_m, area_m2)
        if last is None:
            return
        move_m = common_move(last[1], last[2], centre_m, area_m2, reach_m=(math.inf, SHIFT_ASIDE_M), least=2)
        told_m = travel_m - last[0] if told and last[0] is not None else None
        if move_m is not None and max(math.hypot(*move_m), abs(told_m or 0.0)) >= LEAST_STEP_M:
            self._moves.append((told_m, float(move_m[0]), float(move_m[1])))

    @property
    def told_m(self) -> float:
        """By the encoder, over the moves kept."""
        return sum(told_m or 0.0 for told_m, _, _ in self._moves)

    @property
    def seen_m(self) -> float:
        """By the tubers, over the same moves; below 0 where they move against the belt's x."""
        moves = [(along_m, aside_m) for told_m, along_m, aside_m in self._moves if told_m is not None]
        return _length_m(sum(along_m for along_m, _ in moves), sum(aside_m for _, aside_m in moves))

    @property
    def scale(self) -> float | None:
        """How many metres the load moved for each that the encoder told; None: not known."""
        pairs = sum(told_m is not None for told_m, _, _ in self._moves)
        if pairs < SHIFT_LEAST or abs(self.told_m) < SHIFT_LEAST_M:
            return None
        return self.seen_m / self.told_m

    @property
    def encoder_off(self) -> bool:
        """The encoder tells another travel: over all the moves kept, and in most of them."""
        pairs = [(told_m, _length_m(x_m, y_m)) for told_m, x_m, y_m in self._moves if told_m is not None]
        if len(pairs) < SHIFT_LEAST or max(abs(self.told_m), abs(self.seen_m)) < SHIFT_LEAST_M:
            return False
        if abs(self.told_m - self.seen_m) <= self.coarse_m:
            return False
        each = np.array([_differ(told_m, seen_m) for told_m, seen_m in pairs])
        return _differ(self.told_m, self.seen_m) and float(each.mean()) >= SHIFT_OFF_SHARE

    @property
    def coarse_m(self) -> float:
        """The steps in which the travel is told, metres, where it stands still between them while the load moves, and
        they are too long for that; else 0.
        """
        told_m = np.array([abs(told_m) for told_m, _, _ in self._moves if told_m is not None])
        if len(told_m) < SHIFT_LEAST or float((told_m == 0).mean()) < COARSE_STOOD or not told_m.any():
            return 0.0
        step_m = float(np.median(told_m[told_m > 0]))
        return step_m if step_m >= COARSE_M else 0.0

    @property
    def backwards(self) -> bool:
        """The encoder is off because the load runs the other way."""
        return self.encoder_off and not _differ(-self.told_m, self.seen_m)

    @property
    def turned_deg(self) -> float | None:
        """From the belt's x to the way the load moves, counter-clockwise as seen from above; None: not known."""
        along_m, aside_m = sum(x_m for _, x_m, _ in self._moves), sum(y_m for _, _, y_m in self._moves)
        if len(self._moves) < SHIFT_LEAST or math.hypot(along_m, aside_m) < SHIFT_LEAST_M:
            return None
        return math.degrees(math.atan2(aside_m, along_m))

    @property
    def turned(self) -> bool:
        """The load moves aside, in most moves to the same side; not just against the belt's x."""
        turned_deg = self.turned_deg
        if turned_deg is None or not TURNED_DEG <= abs(turned_deg) <= 180 - 2 * TURNED_DEG:
            return False
        same = [aside_m * turned_deg > 0 for _, _, aside_m in self._moves]
        return sum(same) >= TURNED_ALIKE * len(same)


def _length_m(along_m: float, aside_m: float) -> float:
    return math.copysign(math.hypot(along_m, aside_m), along_m)


def _differ(told_m: float, seen_m: float) -> bool:
    return abs(told_m - seen_m) > SHIFT_OFF * abs(seen_m)
