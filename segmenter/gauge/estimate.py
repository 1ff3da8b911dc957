"""What many looks at the gauge come to: how far disparity drifted, how far the mount moved, which of them it was."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from conveyor.camera_range import BASELINE_M
from conveyor.gauge import Gauge
from segmenter.gauge.look import GaugeLook

REFERENCE_LOOKS = 60
"""Looks of the run's beginning that later ones are compared with: then, depth is taken for right."""
KEPT_LOOKS = 120
LEAST_LOOKS = 12
RIGHT_AT_FIRST_PX = 0.12
"""Of rods, which tell the distance by themselves, a larger drift at the run's beginning is one and not the look's own
error: the matching window mixes the ground into a rod's crest, by 0.02 to 0.06 px on simulated webs."""
CLIPPED = 3.0
"""Standard deviations from the middle, beyond which a look is a hand or a tuber over an edge."""
LEAST_DRIFT_PX, LEAST_SHIFT_M = 0.04, 0.001
"""What is smaller is none, though it is corrected: 0.04 px are 1 mm at 0.46 m, and no calibration is better."""
SURE = 3.0
"""Standard errors from which on a drift or a shift is one."""
MOST_DRIFT_PX = 0.6
"""What is corrected at most; the largest drift that users report is 0.4 px. More is a camera to be looked after."""


class Cause(StrEnum):
    """Why the belt is not where it was calibrated."""

    NONE = "none"
    MOUNT = "mount"
    DRIFT = "drift"
    BOTH = "both"


@dataclass(frozen=True, slots=True)
class GaugeReading:
    """The belt by depth and by the gauge.

    Attributes:
        drift_per_m: what every 1/z is too large by; `drift_px` the same as disparity on a baseline of 18 mm.
        drift_sd_px: standard error of that.
        shift_m: how much farther from the belt the camera is than calibrated, by the gauge; shift_sd_m: of that.
    """

    drift_per_m: float
    drift_px: float
    drift_sd_px: float
    shift_m: float
    shift_sd_m: float

    @property
    def cause(self) -> Cause:
        """Which of the two it is."""
        drifted = abs(self.drift_px) > max(LEAST_DRIFT_PX, SURE * self.drift_sd_px)
        moved = abs(self.shift_m) > max(LEAST_SHIFT_M, SURE * self.shift_sd_m)
        if drifted and moved:
            return Cause.BOTH
        return Cause.DRIFT if drifted else Cause.MOUNT if moved else Cause.NONE

    @property
    def correction_per_m(self) -> float:
        """What to take from 1/z of every pixel: less than a drift that is hardly known, nothing of one too large."""
        if abs(self.drift_px) > MOST_DRIFT_PX:
            return 0.0
        certain = self.drift_px**2 / max(self.drift_px**2 + self.drift_sd_px**2, 1e-12)
        return certain * self.drift_per_m

    @property
    def beyond(self) -> bool:
        """The drift is larger than what is corrected."""
        return self.cause in (Cause.DRIFT, Cause.BOTH) and abs(self.drift_px) > MOST_DRIFT_PX


class GaugeEstimate:
    """Looks of one camera, the newest `KEPT_LOOKS`; the belt is calibrated at `given_m`."""

    def __init__(self, gauge: Gauge, *, given_m: float, focal_px: float) -> None:
        self._gauge = gauge
        self._given_m = given_m
        self._strength = focal_px * BASELINE_M
        self._reference: list[GaugeLook] = []
        self._looks: deque[GaugeLook] = deque(maxlen=KEPT_LOOKS)

    def add(self, look: GaugeLook) -> None:
        """Take one more look."""
        (self._reference if len(self._reference) < REFERENCE_LOOKS else self._looks).append(look)

    def reading(self) -> GaugeReading | None:
        """What the looks come to; None while there are too few."""
        if len(self._looks) < LEAST_LOOKS:
            return None
        return read(self._looks, self._reference, self._gauge, given_m=self._given_m, strength=self._strength)


def read(
    looks: Sequence[GaugeLook], reference: Sequence[GaugeLook], gauge: Gauge, *, given_m: float, strength: float
) -> GaugeReading:
    """The reading of some looks.

    Args:
        reference: looks at the run's beginning.
        given_m: the belt's distance as calibrated.
        strength: focal length in pixels times 18 mm.
    """
    drift, drift_sd = _middle([1 / look.seen_m - 1 / look.by_gauge_m for look in looks])
    distance_m, distance_sd_m = _middle([look.by_gauge_m for look in looks])
    before, before_sd = _middle([1 / look.seen_m - 1 / look.by_gauge_m for look in reference])
    if not gauge.absolute:
        # The gauge was right then, whatever it said: the same error lies in its distance now.
        distance_m = 1 / (1 / distance_m + before)
        distance_sd_m = float(np.hypot(distance_sd_m, distance_m**2 * before_sd))
    if not gauge.absolute or strength * abs(before) < RIGHT_AT_FIRST_PX:
        drift, drift_sd = drift - before, float(np.hypot(drift_sd, before_sd))
    return GaugeReading(drift, strength * drift, strength * drift_sd, distance_m - given_m, distance_sd_m)


def _middle(values: Sequence[float]) -> tuple[float, float]:
    """(mean without outliers, its standard error). A mean, because a belt that shakes is mostly at its two ends."""
    found = np.asarray(values)
    apart = np.abs(found - np.median(found))
    kept = found[apart <= CLIPPED * 1.4826 * np.median(apart) + 1e-12]
    return float(kept.mean()), float(kept.std() / np.sqrt(max(len(kept) - 1, 1)))
