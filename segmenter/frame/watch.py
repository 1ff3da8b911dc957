"""Whether the belt is where its calibration says, and runs the way its pose says. Looks on; changes no count."""

from __future__ import annotations

from collections import deque
from statistics import median

import numpy as np
from numpy.typing import NDArray

from segmenter.frame.constants import (
    BACKWARDS_M,
    BACKWARDS_SHARE,
    KEPT_CHECKS,
    LEAST_CHECKS,
    LEAST_STEP_M,
    LEAST_VOTES,
    LONGEST_STEP_M,
    SAME_M,
)
from segmenter.frame.instances import Instances
from segmenter.frame.motion_watch import MotionWatch
from segmenter.frame.plane import BeltCheck


class BeltWatch:
    """Levels of one camera: 'belt_drift_mm' and 'belt_tilt_off_deg' (seen against given), 'belt_alarm', 1 where either
    is too much, 'belt_backwards', 1 where tubers move against the belt's x, 'belt_turned', 1 where they move aside, by
    'belt_turned_deg', and 'encoder_off', 1 where they move 'encoder_seen_m' while the encoder tells 'encoder_told_m'.
    'encoder_scale' is how many metres they move for each that it tells, 'encoder_coarse_m' the steps in which it tells
    them where those are too long.
    """

    def __init__(self) -> None:
        self._checks: deque[BeltCheck] = deque(maxlen=KEPT_CHECKS)
        self._newest: BeltCheck | None = None
        self._last: tuple[float, NDArray[np.float64]] | None = None
        self._forwards = 0
        self._backwards = 0
        self._first_m: float | None = None
        self._moved_m = 0.0
        self._motion = MotionWatch()

    def step(self, check: BeltCheck, instances: Instances | None, *, travel_m: float, told: bool) -> None:
        """Take what the core says after one more frame; `told`: its travel, by an encoder."""
        if check is not self._newest:
            self._newest = check
            if check.drift_m is not None:
                self._checks.append(check)
        self._first_m = travel_m if self._first_m is None else self._first_m
        self._moved_m = travel_m - self._first_m
        if instances is None:
            return
        if told:
            self._vote(instances, travel_m)
        self._motion.step(instances, travel_m, told=told)

    def gauges(self) -> dict[str, float]:
        """The levels that are known."""
        backwards = self.backwards
        # The tubers move another way than encoder or pose say, and not just against it.
        encoder_off, turned = (off and not backwards for off in (self._motion.encoder_off, self._motion.turned))
        levels = {"belt_backwards": float(backwards), "encoder_off": float(encoder_off), "belt_turned": float(turned)}
        levels["encoder_coarse_m"] = 0.0 if encoder_off else self._motion.coarse_m
        if encoder_off:
            levels |= {"encoder_told_m": self._motion.told_m, "encoder_seen_m": self._motion.seen_m}
        if (scale := self._motion.scale) is not None:
            levels["encoder_scale"] = scale
        if (turned_deg := self._motion.turned_deg) is not None:
            levels["belt_turned_deg"] = turned_deg
        if self._checks:
            middle = self._middle()
            levels |= {
                "belt_drift_mm": (middle.drift_m or 0.0) * 1000,
                "belt_tilt_off_deg": middle.tilt_off_deg or 0.0,
                "belt_alarm": float(len(self._checks) >= LEAST_CHECKS and middle.alarm),
            }
        return levels

    @property
    def backwards(self) -> bool:
        """The belt moves against its x: by the travel itself, or, where an encoder tells that, by the tubers. Travel
        that is estimated along x may be anything where they move aside of it.
        """
        votes = self._forwards + self._backwards
        by_tubers = votes >= LEAST_VOTES and self._backwards >= BACKWARDS_SHARE * votes
        by_travel = self._moved_m < BACKWARDS_M and not self._motion.turned
        return by_tubers or by_travel or self._motion.backwards

    def _middle(self) -> BeltCheck:
        drifts = [check.drift_m for check in self._checks if check.drift_m is not None]
        tilts = [check.tilt_off_deg for check in self._checks if check.tilt_off_deg is not None]
        return BeltCheck(None, median(drifts), median(tilts) if tilts else None)

    def _vote(self, instances: Instances, travel_m: float) -> None:
        """Where the tubers of the last frame should be now, had they moved with the travel, or against it: each by
        itself, for where one lies at a time no two of them share a move (`MotionWatch`).
        """
        whole = ~instances.cut.any(axis=1)
        now = instances.centre_m[whole]
        last, self._last = self._last, (travel_m, now)
        if last is None or not len(now) or not len(last[1]):
            return
        step_m = travel_m - last[0]
        if not LEAST_STEP_M <= abs(step_m) <= LONGEST_STEP_M:
            return
        along = np.array([step_m, 0.0])
        with_belt, against = (_nearest_m(last[1] + sign * along, now) for sign in (1.0, -1.0))
        self._forwards += int(np.count_nonzero((with_belt < SAME_M) & (with_belt < against)))
        self._backwards += int(np.count_nonzero((against < SAME_M) & (against < with_belt)))


def _nearest_m(places_m: NDArray[np.float64], others_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) from each of (n, 2) places to the nearest of (m, 2) others."""
    gap_m = places_m[:, None] - others_m[None]
    return np.asarray(np.hypot(gap_m[..., 0], gap_m[..., 1]).min(axis=1))
