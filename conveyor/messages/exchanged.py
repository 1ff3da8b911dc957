"""A camera that is another one than it was."""

from __future__ import annotations

from dataclasses import dataclass

from conveyor.ranges import Line, Name, Nanoseconds


@dataclass(frozen=True, slots=True)
class CameraExchanged:
    """A camera whose device, resolution or depth unit changed in a run, or since the run before.

    Attributes:
        before, now: serial number, where the source knows it, intrinsics and depth unit.
        since_ns: the first frame of the one that is there now, by the camera's clock.
    """

    camera: Name
    before: Line
    now: Line
    since_ns: Nanoseconds
