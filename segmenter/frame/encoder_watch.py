"""Whether the load moves as far as the encoder says. Looks on; changes no count.

An encoder that stands still, or that counts another number of pulses a metre, puts every tuber at several places or at
none. From one frame to the next all tubers move alike: the shift that most pairs of them share is how far they moved.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from segmenter.frame.constants import (
    LEAST_STEP_M,
    SHIFT_AREA,
    SHIFT_KEPT,
    SHIFT_LEAST,
    SHIFT_LEAST_M,
    SHIFT_OFF,
    SHIFT_OFF_SHARE,
    SHIFT_SAME_M,
)
from segmenter.frame.instances import Instances

Places = NDArray[np.float64]


class EncoderWatch:
    """The newest moves of the belt, each as the encoder told it and as the tubers showed it, metres."""

    def __init__(self) -> None:
        self._moves: deque[tuple[float, float]] = deque(maxlen=SHIFT_KEPT)
        self._last: tuple[float, Places, Places] | None = None

    def step(self, instances: Instances, travel_m: float) -> None:
        """Take one more frame: its instances, and the travel that the encoder told with it."""
        whole = ~instances.cut.any(axis=1)
        centre_m, area_m2 = instances.centre_m[whole], instances.area_m2[whole]
        last, self._last = self._last, (travel_m, centre_m, area_m2)
        if last is None:
            return
        seen_m = shared_shift_m(last[1], centre_m, areas_m2=(last[2], area_m2))
        told_m = travel_m - last[0]
        if seen_m is not None and max(abs(seen_m), abs(told_m)) >= LEAST_STEP_M:
            self._moves.append((told_m, seen_m))

    @property
    def told_m(self) -> float:
        """By the encoder, over the moves kept."""
        return sum(told for told, _ in self._moves)

    @property
    def seen_m(self) -> float:
        """By the tubers, over the same moves."""
        return sum(seen for _, seen in self._moves)

    @property
    def off(self) -> bool:
        """The encoder tells another travel: over all the moves kept, and in most of them."""
        if len(self._moves) < SHIFT_LEAST or max(abs(self.told_m), abs(self.seen_m)) < SHIFT_LEAST_M:
            return False
        each = np.array([_differ(told, seen) for told, seen in self._moves])
        return _differ(self.told_m, self.seen_m) and float(each.mean()) >= SHIFT_OFF_SHARE

    @property
    def backwards(self) -> bool:
        """It is off because the load runs the other way."""
        return self.off and not _differ(-self.told_m, self.seen_m)


def _differ(told_m: float, seen_m: float) -> bool:
    return abs(told_m - seen_m) > SHIFT_OFF * abs(seen_m)


def shared_shift_m(before_m: Places, now_m: Places, *, areas_m2: tuple[Places, Places]) -> float | None:
    """How far tubers moved along the belt between two frames, metres; None where too few of them share a shift.

    Args:
        before_m, now_m: (n, 2) and (m, 2) centres in belt coordinates, metres.
        areas_m2: (n,) and (m,) their visible areas: those of one tuber are alike.
    """
    least = max(2.0, min(len(before_m), len(now_m)) / 2)
    ratio = areas_m2[1][None, :] / areas_m2[0][:, None]
    alike = (np.abs(now_m[None, :, 1] - before_m[:, None, 1]) < SHIFT_SAME_M) & (np.abs(np.log(ratio)) < SHIFT_AREA)
    shifts_m = (now_m[None, :, 0] - before_m[:, None, 0])[alike]
    if len(shifts_m) < least:
        return None
    near = np.abs(shifts_m[:, None] - shifts_m[None, :]) < SHIFT_SAME_M
    shared = near[int(near.sum(axis=1).argmax())]
    return float(np.median(shifts_m[shared])) if shared.sum() >= least else None
