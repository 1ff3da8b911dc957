"""Do a load's tubers lie lower than those of earlier loads of the line? From sums of heights over widths. Pure.

Height over width is nearly a line, with a scatter of some 6 mm. Tubers that lie lower on the belt than they did, or a
belt plane that is off, move its intercept. A depth scale that changed makes heights and widths larger alike. The
intercept itself depends on the cultivar by some 3 mm, so loads of one variety are compared, and the change counts.

Loads differ in size, and larger tubers are larger all over: a load's mean height is compared with that of the earlier
ones at its own mean width, scaled as their mean height to their mean width. The slope within loads is flatter, for
tubers of one width differ in height; with it a load of 5 % larger tubers would seem to lie 1 mm higher.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from aggregator.core.height_sums import TENTHS, HeightSums
from conveyor.messages import HeightChange

LEAST_TUBERS = 100
"""Of a load, and of the earlier ones together: with fewer nothing is said."""
BETWEEN_SD_MM = 0.5
"""By which loads differ though nothing changed: their sizes and poses do. Of 80 simulated lines with loads of 3000
tubers whose sizes differ by 5 % and more (seeds 61000 and on); with the slope within loads it was 1.2."""
LARGE_MM = 2.0
"""From which on a change is worth an alarm: 4 to 5 % of a load's weight."""
SURE = 3.0
"""Standard errors from which on a change is one."""
MOST_LOADS = 30
"""Earlier loads that a load is compared with: the newest of its kind."""


@dataclass(frozen=True, slots=True)
class Cloud:
    """The tubers of one load in the plane of width and height, millimetres: mean and sums of squares about it."""

    n: int
    width_mm: float
    height_mm: float
    ww: float
    wh: float
    hh: float

    @classmethod
    def of(cls, sums: Sequence[int]) -> Cloud:
        """From one row of `HeightSums`."""
        n, w, h, ww, wh, hh = sums
        # Whole numbers until here, so nothing is lost where large sums are taken from each other.
        spreads = ((n * square - a * b) / n / TENTHS**2 for square, a, b in ((ww, w, w), (wh, w, h), (hh, h, h)))
        return cls(n, w / n / TENTHS, h / n / TENTHS, *spreads)


def height_changes(load: HeightSums, earlier: Sequence[HeightSums]) -> tuple[HeightChange, ...]:
    """What changed against the `earlier` loads, by the cameras that saw the tubers; the newest loads last."""
    found = []
    for cameras, sums in sorted(load.by_cameras.items()):
        before = [Cloud.of(own) for one in earlier[-MOST_LOADS:] if (own := one.by_cameras.get(cameras))]
        before = [cloud for cloud in before if cloud.ww > 0]
        if sums[0] >= LEAST_TUBERS and sum(cloud.n for cloud in before) >= LEAST_TUBERS:
            found.append(_change(cameras, Cloud.of(sums), before))
    return tuple(change for change in found if change is not None)


def _change(cameras: str, now: Cloud, before: Sequence[Cloud]) -> HeightChange | None:
    free = sum(cloud.n for cloud in (now, *before)) - len(before) - 1
    if now.ww <= 0:
        return None
    between = math.fsum(c.n * c.height_mm for c in before) / math.fsum(c.n * c.width_mm for c in before)
    # Of heights less what the width makes of them, within loads.
    variance = max(0.0, math.fsum(c.hh - 2 * between * c.wh + between**2 * c.ww for c in (now, *before))) / free
    # Earlier loads count by how well each is known, and none for more than what differs from load to load.
    weights = [1 / (BETWEEN_SD_MM**2 + variance / cloud.n) for cloud in before]
    total = math.fsum(weights)
    before_mm = (
        math.fsum(w * (c.height_mm - between * c.width_mm) for w, c in zip(weights, before, strict=True)) / total
    )
    lower_mm = before_mm + between * now.width_mm - now.height_mm
    sd_mm = math.sqrt(variance / now.n + BETWEEN_SD_MM**2 + 1 / total)
    scale, scale_sd = _scale(now, before)
    return HeightChange(
        cameras=cameras,
        lower_mm=lower_mm,
        lower_sd_mm=sd_mm,
        scale_percent=100 * scale,
        scale_sd_percent=100 * scale_sd,
        tubers=sum(cloud.n for cloud in before),
        loads=len(before),
        alarm=abs(lower_mm) >= max(LARGE_MM, SURE * sd_mm),
    )


def _scale(now: Cloud, before: Sequence[Cloud]) -> tuple[float, float]:
    """(slope within this load over that within the earlier ones, less 1; its standard error)."""
    ww, wh = math.fsum(cloud.ww for cloud in before), math.fsum(cloud.wh for cloud in before)
    if wh <= 0:
        return 0.0, 0.0
    was = wh / ww
    hh = math.fsum(cloud.hh for cloud in (now, *before)) - (wh + now.wh) ** 2 / (ww + now.ww)
    variance = max(0.0, hh) / (sum(cloud.n for cloud in (now, *before)) - len(before) - 1)
    return now.wh / now.ww / was - 1, math.sqrt(variance / now.ww + variance / ww) / was
