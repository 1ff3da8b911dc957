"""What every source of frames is: a description, then frames in order, with those that cannot be used named."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError, UnsendableError
from conveyor.geometry import Intrinsics
from conveyor.messages import Frame
from conveyor.pose import pose_fault


@dataclass(frozen=True, slots=True)
class CameraDescription:
    """One camera of a recording, or a live one, before its first frame.

    Attributes:
        origin: where it comes from, in words.
        belt_from_camera: (4, 4) or None: straight down.
        frames: how many frames there are, or None where only reading tells.
        live: frames come at their own pace and are lost when no one takes them.
        notes: what a user should know about this camera's recording.
        resting_offset_mm: how far below the belt plane tubers' undersides lie, where the recording says it; positive
            is below. `resting_sd_mm`: how well that is known, standard deviation.
        serial: the device's serial number, where it is known.
    """

    name: str
    origin: str
    intrinsics: Intrinsics
    depth_scale_m: float
    belt_distance_m: float | None
    belt_from_camera: NDArray[np.float64] | None
    fps: float
    frames: int | None
    live: bool = False
    notes: tuple[str, ...] = ()
    resting_offset_mm: float | None = None
    resting_sd_mm: float | None = None
    serial: str | None = None

    def __post_init__(self) -> None:
        """Refuse a pose that is no rigid transform, whatever format it comes from."""
        fault = None if self.belt_from_camera is None else pose_fault(self.belt_from_camera)
        if fault:
            raise InputError(f"{self.origin}, camera '{self.name}': {fault}")


@dataclass(frozen=True, slots=True)
class Refused:
    """A frame that is there but cannot be used: its number is a gap downstream.

    `reason` is a short word to count by, `text` says which file, what is wrong and how to fix it.
    """

    seq: int
    reason: str
    text: str


def within_ranges(item: Frame | Refused) -> Frame | Refused:
    """The frame, or why it is none that can be sent or written: bags hold times before 1970, say."""
    if isinstance(item, Refused):
        return item
    try:
        item.check()
    except UnsendableError as error:
        fault = str(error).removeprefix("not sent: ")
        return Refused(item.seq, "out_of_range", f"frame {item.seq} of {item.camera}: {fault}")
    return item


@dataclass(frozen=True, slots=True)
class FrameKey:
    """Number and capture time of a frame that is not read."""

    seq: int
    captured_ns: int


class Source(Protocol):
    """Frames of one camera. `frames` may be called again and then starts at the first frame (not for live cameras)."""

    @property
    def description(self) -> CameraDescription:
        """What is known before the first frame."""
        ...

    def frames(self, *, run: str, after: int = -1) -> Iterator[Frame | Refused]:
        """All frames numbered above `after`, in order of their numbers, stamped with `run`."""
        ...


@runtime_checkable
class PolledSource(Source, Protocol):
    """A live source that does not block its process while nothing comes."""

    def attach(self, poll: Callable[[float], bool]) -> None:
        """Call `poll` several times a second with how long nothing has come, seconds; False ends the frames."""
        ...


class RecordedSource(Source, Protocol):
    """A source that can be read again and knows its frames before reading them."""

    def keys(self) -> list[FrameKey]:
        """Of all frames in their order, without reading images."""
        ...
