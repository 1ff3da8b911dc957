"""Which device a camera's frames come from, as it says itself: to notice that another one hangs there now."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

from conveyor.messages import CameraInfo

MOST_DEVICES = 8
"""Of one camera in one run that are remembered; beyond it those in between are forgotten."""


@dataclass(frozen=True, slots=True)
class Device:
    """A device as it is set.

    Attributes:
        since_ns: its first frame, by the camera's clock.
        serial: its serial number; '' where the source knows none.
        lens: its intrinsics and depth unit, in words; no two devices share them to thousandths of a pixel.
    """

    since_ns: int
    serial: str
    lens: str

    @classmethod
    def of(cls, info: CameraInfo) -> Self:
        """The one that `info` tells of."""
        k = info.intrinsics
        focal, centre = f"fx {k.fx:.6g}, fy {k.fy:.6g}", f"cx {k.cx:.6g}, cy {k.cy:.6g} px"
        lens = f"{k.width}x{k.height}, {focal}, {centre}, unit {1000 * info.depth_scale_m:.6g} mm"
        return cls(info.first_captured_ns or 0, info.serial or "", lens)

    def differs(self, other: Device) -> bool:
        """It is another device than `other`, or set to another resolution or unit."""
        return self.lens != other.lens or bool(self.serial and other.serial and self.serial != other.serial)

    @property
    def told(self) -> str:
        """In words."""
        return f"serial {self.serial}, {self.lens}" if self.serial else self.lens


def with_newest(devices: list[Device], newest: Device) -> list[Device]:
    """The devices of a camera, oldest first, with the one that it tells of now; one that is the same is there once."""
    if not devices or newest.differs(devices[-1]):
        return [*devices[:1], *devices[1:][-(MOST_DEVICES - 2) :], newest]
    if newest.serial and not devices[-1].serial:  # told by a later version of the camera's program
        return [*devices[:-1], replace(devices[-1], serial=newest.serial)]
    return devices
