"""Does the depth scale fit the belt distance? A wrong factor of ten is the commonest fault of depth recordings."""

from __future__ import annotations

import numpy as np

from conveyor.formats.source import Refused
from conveyor.geometry import belt_distance_m
from conveyor.messages import Frame

LOW, HIGH = 0.6, 1.25
"""The median depth of a full belt lies up to 90 mm above the belt, so below its distance more than beyond it."""
COARSEST_M = 0.01
"""Metres; no camera's depth unit is coarser."""
ENOUGH_SHARE = 0.25
"""Beside a narrow belt the floor is seen: a scale that fits so much of the image is right."""
RODS_LOW, RODS_HIGH, RODS_SHARE = 0.92, 1.03, 0.05
"""Between the rods of a web the ground is seen: rods that lie where the belt is said to be are enough."""
ENOUGH_FIT = 3
"""Frames that fit, after which no more is asked."""


def expected_distance_m(frame: Frame) -> float | None:
    """The belt distance a frame claims, from its transform or its number, metres."""
    if frame.belt_from_camera is not None:
        return belt_distance_m(frame.belt_from_camera)
    return frame.belt_distance_m


def median_depth_m(frame: Frame) -> float | None:
    """Median of the frame's depth in metres; None where fewer than 100 pixels have any."""
    seen = frame.depth[frame.depth > 0]
    return float(np.median(seen)) * frame.depth_scale_m if len(seen) >= 100 else None


def scale_fault(seen_m: float, expected_m: float, depth_scale_m: float) -> str | None:
    """What is wrong, in words, or None where both agree."""
    ratio = seen_m / expected_m
    if LOW <= ratio <= HIGH:
        return None
    text = f"the median depth is {seen_m:.4g} m but the belt is said to be {expected_m:.4g} m away"
    decade = round(np.log10(ratio))
    if decade != 0 and LOW <= ratio / 10.0**decade <= HIGH:
        right = depth_scale_m / 10.0**decade
        if right > COARSEST_M:
            unit = {-2: "centimetres", -3: "millimetres"}.get(decade, "another unit")
            return f"{text}: that seems to be in {unit}; belt_distance_m and belt_from_camera are in metres"
        return (
            f"{text}: off by {10.0 ** abs(decade):g}, so depth_scale_m is {depth_scale_m:g} and should be {right:g} "
            "(the D405 delivers 0.0001 m units by default, recordings of the paper use 0.001)"
        )
    return f"{text}; fix belt_distance_m (measure it) or depth_scale_m ({depth_scale_m:g})"


class ScaleCheck:
    """The first frames of one camera. Until `ENOUGH_FIT` of them have fitted their belt distance, those that do not are
    refused: a view that is blocked, or a picture that failed, looks like a wrong scale, and is none where others fit.

    Attributes:
        against: the first refusal, while no frame has fitted; None where one has, or all is well.
        misfits: frames that were refused.
    """

    def __init__(self, where: str) -> None:
        self.against: Refused | None = None
        self.misfits = 0
        self._where = where
        self._fitted = 0

    def refusal(self, frame: Frame) -> Refused | None:
        """Why a frame is not to be used; None where it may be."""
        if self._fitted >= ENOUGH_FIT:
            return None
        expected, seen = expected_distance_m(frame), median_depth_m(frame)
        if expected is None or seen is None:
            return None
        fault = scale_fault(seen, expected, frame.depth_scale_m)
        if fault is None or _shows_belt(frame, expected):
            self._fitted += 1
            self.against = None
            return None
        text = f"{self._where}, camera '{frame.camera}', frame {frame.seq}: {fault}"
        refused = Refused(frame.seq, "depth_scale", f"{text}; or something is before the camera")
        if not self._fitted:
            self.against = self.against or refused
        self.misfits += 1
        return refused


def _shows_belt(frame: Frame, expected_m: float) -> bool:
    """Enough of the image, or the rods of a web, lie where the belt is said to be."""
    return _share_at(frame, expected_m) >= ENOUGH_SHARE or (
        _share_at(frame, expected_m, low=RODS_LOW, high=RODS_HIGH) >= RODS_SHARE
    )


def _share_at(frame: Frame, expected_m: float, *, low: float = LOW, high: float = HIGH) -> float:
    """Share of the measured pixels whose depth is `low` to `high` times that of a belt at `expected_m`."""
    ratio = frame.depth[frame.depth > 0] * frame.depth_scale_m / expected_m
    return float(np.mean((ratio >= low) & (ratio <= high)))
