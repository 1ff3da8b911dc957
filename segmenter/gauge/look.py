"""One look at the gauge: how far the belt is by its size, beside how far it seems by its depth.

A disparity that is off by a constant moves 1/z by a constant, whatever is looked at: all lengths grow by what depth
grows by. A camera that moved sees everything at its true size. So a length that is known gives the true distance.
"""

from __future__ import annotations

from dataclasses import dataclass

from conveyor.gauge import Gauge
from conveyor.messages import Frame
from segmenter.frame.belt import BeltGeometry
from segmenter.gauge.bar import bar_distance_m
from segmenter.gauge.rods import rods_distances_m
from segmenter.gauge.width import width_scale


@dataclass(frozen=True, slots=True)
class GaugeLook:
    """Camera to belt along the optical axis, metres: as its depth says, and as the gauge's size says."""

    seen_m: float
    by_gauge_m: float


def look_at(frame: Frame, belt: BeltGeometry, gauge: Gauge, *, seen_m: float | None) -> GaugeLook | None:
    """What the frame says; None where the gauge is not seen well enough.

    Args:
        frame: as the camera gave it.
        belt: as it is calibrated.
        seen_m: how far the belt plane seems, where it is seen; of no use for rods, between which one sees the ground.
    """
    if gauge.kind == "rods":
        found = rods_distances_m(frame, belt, pitch_m=gauge.pitch_m, radius_m=gauge.rod_m / 2)
        return None if found is None else GaugeLook(*found)
    if seen_m is None:
        return None
    if gauge.kind == "bar":
        by_bar_m = bar_distance_m(frame, belt, size_m=gauge.size_m, place_m=gauge.place_m, seen_m=seen_m)
        return None if by_bar_m is None else GaugeLook(seen_m, by_bar_m)
    scale = width_scale(frame, belt, width_m=gauge.width_m, seen_m=seen_m)
    return None if scale is None else GaugeLook(seen_m, seen_m / scale)
