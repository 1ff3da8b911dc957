"""How far apart two cameras put the tubers that both see."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from conveyor.ranges import Count, Name, Range, Yes

ApartMm = Annotated[float, Range(-1e5, 1e5, "mm")]


@dataclass(frozen=True, slots=True)
class CamerasApart:
    """Two cameras, by the newest tubers that both saw.

    Attributes:
        first, second: their names.
        along_mm, across_mm: places by the second one, less those by the first one.
        shared: so many tubers say that; twice: of them, how many were counted twice.
        alarm: so far that tubers are counted twice, or soon would be.
    """

    first: Name
    second: Name
    along_mm: ApartMm
    across_mm: ApartMm
    shared: Count
    twice: Count
    alarm: Yes
