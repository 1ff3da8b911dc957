"""How large a tuber is: caliper axes and square-mesh size, each with its standard deviation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from conveyor.ranges import Range
from conveyor.statistics import NORMAL_90

SizeMm = Annotated[float, Range(0, 2001, "mm")]
SizeSdMm = Annotated[float, Range(0, 1e6, "mm")]

MEASURES = ("length", "width", "thickness", "mesh")
"""What `Sizes` holds of each tuber, by name."""


@dataclass(frozen=True, slots=True)
class Sizes:
    """What a caliper and a riddle would say of a tuber, estimated from what one side of it shows.

    Attributes:
        length_mm, width_mm, thickness_mm: sorted caliper axes of the whole tuber, the hidden side included.
        mesh_mm: side of the smallest square hole that it passes, turned as it likes.
        length_sd_mm, width_sd_mm, thickness_sd_mm, mesh_sd_mm: standard deviation of each.
    """

    length_mm: SizeMm
    width_mm: SizeMm
    thickness_mm: SizeMm
    mesh_mm: SizeMm
    length_sd_mm: SizeSdMm
    width_sd_mm: SizeSdMm
    thickness_sd_mm: SizeSdMm
    mesh_sd_mm: SizeSdMm

    def of(self, measure: str) -> tuple[float, float]:
        """(value, standard deviation) of 'length', 'width', 'thickness' or 'mesh', millimetres."""
        return float(getattr(self, f"{measure}_mm")), float(getattr(self, f"{measure}_sd_mm"))

    def interval_mm(self, measure: str) -> tuple[float, float]:
        """Bounds of the 90 % interval of a measure, millimetres."""
        value_mm, sd_mm = self.of(measure)
        return max(0.0, value_mm - NORMAL_90 * sd_mm), value_mm + NORMAL_90 * sd_mm
