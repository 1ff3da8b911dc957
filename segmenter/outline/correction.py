"""What the load itself says of its camera, taken off the views and lengths of the tubers that pass next."""

from __future__ import annotations

from dataclasses import dataclass, replace

from conveyor.camera_flags import FLANKS_RAISED, OUTLINE_GROWN, OUTLINE_LOST, SCALED_BY_TRAVEL
from conveyor.geometry import belt_distance_m
from conveyor.messages import View
from segmenter.gauge.drift import without_drift
from segmenter.outline.flanks import FlankReading, without_rise
from segmenter.outline.growth import without_growth
from segmenter.outline.watch import OutlineReading

DEPTH_SD, BENT_SD = 0.015, 0.005
"""Of what a camera's distances are off by, and of what depth that is bent across the image makes of it; as shares."""
MOST_FARTHER = 0.05
"""No camera that works is off by more: it is the encoder, or the belt slips. It is told, and nothing is scaled."""


@dataclass(frozen=True, slots=True)
class CameraCorrection:
    """How far a camera is off.

    Attributes:
        grown_px: by how much it lets outlines grow. lost_mm: what it takes off them beyond what weights know.
        farther: by how much farther away than they are it puts tubers, as a share of their distance.
        at_m: how far away it sees tubers, along its optical axis.
        raised_m: by how much it raises flanks, by pixel inside the outline.
    """

    grown_px: float = 0.0
    lost_mm: float = 0.0
    farther: float = 0.0
    at_m: float = 1.0
    raised_m: tuple[float, ...] = ()

    @property
    def flags(self) -> tuple[str, ...]:
        """Of the tubers that are corrected."""
        outline = (OUTLINE_GROWN,) if self.grown_px else (OUTLINE_LOST,) if self.lost_mm else ()
        return (*outline, *((FLANKS_RAISED,) if self.raised_m else ()), *((SCALED_BY_TRAVEL,) if self.farther else ()))

    @property
    def drift_per_m(self) -> float:
        """What 1/z of all that is seen is too large by, 1/metres: disparity drifts by a constant."""
        return -self.farther / self.at_m

    @property
    def true_per_seen(self) -> float:
        """Factor from a length across the view, as a tuber's is seen, to the true one; depth has its square."""
        return 1 / (1 + self.farther)

    def true_m(self, seen_m: float) -> float:
        """The distance of what is seen at `seen_m`."""
        return 1 / (1 / seen_m - self.drift_per_m)

    def seen_m(self, true_m: float) -> float:
        """Where the camera sees what is `true_m` away."""
        return 1 / (1 / true_m + self.drift_per_m)

    def corrected(self, view: View) -> View:
        """The view without what its outline grew by, its depth and the belt under it where they are."""
        depth = without_rise(view.depth, self.raised_m, depth_scale_m=view.depth_scale_m)
        view = replace(view, depth=without_growth(depth, self.grown_px), outline_lost_mm=self.lost_mm)
        if not self.farther:
            return view
        seen_m = belt_distance_m(view.belt_from_camera)
        pose = view.belt_from_camera.copy()
        pose[:3, 3] *= self.true_m(seen_m) / seen_m
        depth, unit_m = without_drift(view.depth, depth_scale_m=view.depth_scale_m, drift_per_m=self.drift_per_m)
        return replace(view, depth=depth, depth_scale_m=unit_m, belt_from_camera=pose)


NOTHING_OFF = CameraCorrection()


def correction_of(
    reading: OutlineReading | None, flanks: FlankReading | None = None, *, focal_px: float, by_travel: bool
) -> CameraCorrection:
    """What to correct, of what is known so far.

    Args:
        focal_px: of the camera's columns.
        by_travel: travel is told by an encoder that is known to be right, so distances that contradict it are wrong.
    """
    raised_m = flanks.raised_m if flanks is not None else ()
    if reading is None:
        return replace(NOTHING_OFF, raised_m=raised_m)
    farther = scale_error(reading) if by_travel else 0.0
    at_m = focal_px * reading.mm_per_px / 1000
    return CameraCorrection(reading.grown_px, reading.lost_beyond_mm, farther, at_m, raised_m)


def scale_error(reading: OutlineReading) -> float:
    """By how much distances are too large if travel is right, as a share; 0 where no camera is so far off."""
    trust = DEPTH_SD**2 / (DEPTH_SD**2 + BENT_SD**2 + reading.slip_sd**2)
    return round(trust * reading.slip, 4) if abs(reading.slip) <= MOST_FARTHER else 0.0
