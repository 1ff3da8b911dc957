"""How high a load's tubers are for their width, against earlier loads of the line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from conveyor.ranges import Count, Line, Range, Yes

ChangeMm = Annotated[float, Range(-2001, 2001, "mm")]
ChangeSdMm = Annotated[float, Range(0, 2001, "mm")]
ChangePercent = Annotated[float, Range(-1e6, 1e6, "%")]
ChangeSdPercent = Annotated[float, Range(0, 1e6, "%")]


@dataclass(frozen=True, slots=True)
class HeightChange:
    """What is different from earlier loads, for the tubers that these cameras saw together.

    Attributes:
        cameras: their names, with commas between.
        lower_mm: by how much the tubers lie lower than those of the earlier loads, at the same width.
        scale_percent: by how much height grows faster with width: a depth scale that changed would do that.
        lower_sd_mm, scale_sd_percent: standard errors.
        tubers, loads: how many of the earlier loads it is compared with.
        alarm: the tubers lie lower, or higher, by so much that it matters, and surely.
    """

    cameras: Line
    lower_mm: ChangeMm
    lower_sd_mm: ChangeSdMm
    scale_percent: ChangePercent
    scale_sd_percent: ChangeSdPercent
    tubers: Count
    loads: Count
    alarm: Yes
