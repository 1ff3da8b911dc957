"""Sums of tubers' heights and widths: over many tubers they tell that tubers lie lower than they did. Pure.

In tenths of a millimetre and whole numbers, so that they are the same in whatever order tubers come.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Self

from conveyor.camera_flags import CUT
from conveyor.layers import support_mm_of
from conveyor.messages import Tuber

TENTHS = 10
LEAST_RATIO, MOST_RATIO = 0.35, 1.3
"""Height over width of what is used: less is no whole tuber, more is one that stands on end or on others."""


@dataclass(slots=True)
class HeightSums:
    """By the cameras that saw a tuber: n, and sums of width, height, width^2, width * height, height^2."""

    by_cameras: dict[str, list[int]] = field(default_factory=dict)

    def add(self, tuber: Tuber) -> None:
        """Count a tuber that was seen whole and lies on the belt."""
        width, height = round(TENTHS * tuber.width_mm), round(TENTHS * tuber.height_mm)
        if CUT in tuber.flags or support_mm_of(tuber.flags) > 0:
            return
        if LEAST_RATIO * width < height < MOST_RATIO * width:
            self._put(", ".join(sorted(tuber.cameras)), [1, width, height, width**2, width * height, height**2])

    def take(self, other: Self) -> None:
        """Add what `other` summed up."""
        for cameras, sums in other.by_cameras.items():
            self._put(cameras, sums)

    def _put(self, cameras: str, sums: list[int]) -> None:
        had = self.by_cameras.get(cameras, [0] * 6)
        self.by_cameras[cameras] = [a + b for a, b in zip(had, sums, strict=True)]

    def plain(self) -> dict[str, Any]:
        """As JSON keeps it."""
        return dict(sorted(self.by_cameras.items()))

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> Self:
        """Back from `plain`."""
        return cls({cameras: list(sums) for cameras, sums in plain.items()})
