"""What a camera sends, and what it is told back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import MessageError
from conveyor.geometry import Intrinsics
from conveyor.messages.base import ArraySpec, Message


@dataclass(frozen=True, slots=True)
class Frame(Message):
    """One depth image with everything needed to read it.

    Attributes:
        camera: name of the camera; `run`: id of this run of the line.
        seq: sequence number per camera and run; a gap means a lost frame.
        after_seq: number of the frame that a camera that waits sent before this one (-1: none): whoever has not got
            that one waits for it, so that what a link lost, or delivers late, is no gap. None where nobody waits.
        captured_ns: capture time, nanoseconds of the camera's clock.
        travel_m: belt travel at capture from an encoder, metres; None where it must be estimated.
        depth: (H, W) uint16, units of `depth_scale_m` metres, 0 = no depth.
        belt_distance_m: camera to belt along the optical axis, metres, or None if not calibrated.
        belt_from_camera: (4, 4) float64 rigid transform, or None: straight down at `belt_distance_m`.
        mask: (H, W) uint16 given instance labels, 0 = background, or None.
        color_jpeg: (n,) uint8, a JPEG file aligned to the depth image, or None.
    """

    camera: str
    run: str
    seq: int
    captured_ns: int
    travel_m: float | None
    depth_scale_m: float
    intrinsics: Intrinsics
    belt_distance_m: float | None
    depth: NDArray[np.uint16]
    belt_from_camera: NDArray[np.float64] | None = None
    mask: NDArray[np.uint16] | None = None
    color_jpeg: NDArray[np.uint8] | None = None
    after_seq: int | None = None

    ARRAYS: ClassVar[dict[str, ArraySpec]] = {
        "depth": ArraySpec("u2", 2),
        "belt_from_camera": ArraySpec("f8", 2, optional=True),
        "mask": ArraySpec("u2", 2, optional=True),
        "color_jpeg": ArraySpec("u1", 1, optional=True),
    }

    def __post_init__(self) -> None:
        size = (self.intrinsics.height, self.intrinsics.width)
        for name, array in (("depth", self.depth), ("mask", self.mask)):
            if array is not None and array.shape != size:
                raise MessageError(f"Frame.{name} is {array.shape}, the intrinsics are for {size} (rows, columns)")
        if self.belt_from_camera is not None and self.belt_from_camera.shape != (4, 4):
            raise MessageError(f"Frame.belt_from_camera is {self.belt_from_camera.shape}, not (4, 4)")


@dataclass(frozen=True, slots=True)
class CameraInfo(Message):
    """What a camera is and how far it got. `state` 'ended' is the last word of a recording.

    `published` counts frames put on the wire, `last_seq` is the newest sequence number; `first_seq` the first one
    of the run. `waits` says that the camera waits for the segmenter's progress and so loses nothing (a replay).
    `refused` counts frames the source could not read, by reason; their sequence numbers are gaps downstream.
    `first_captured_ns`, `first_travel_m`, `last_captured_ns`, `last_travel_m` are of the first and the newest frame
    published by this process (None before the first; no travel without an encoder): belt that passed between them and
    was not processed was not seen. `live`: a device, whose belt may have moved before its first frame.
    """

    camera: str
    run: str
    state: Literal["starting", "streaming", "ended", "failed"]
    source: str
    fps: float
    waits: bool
    intrinsics: Intrinsics
    depth_scale_m: float
    first_seq: int | None
    last_seq: int | None
    published: int
    refused: dict[str, int]
    error: str = ""
    first_captured_ns: int | None = None
    first_travel_m: float | None = None
    last_captured_ns: int | None = None
    last_travel_m: float | None = None
    live: bool = False


@dataclass(frozen=True, slots=True)
class FrameProgress(Message):
    """The segmenter is done with all frames up to `done_seq` (-1: none yet) and takes `window` more."""

    camera: str
    run: str
    done_seq: int
    window: int


@dataclass(frozen=True, slots=True)
class Travel(Message):
    """How far the belt has moved since the run started, metres, at `captured_ns`."""

    source: str
    run: str
    captured_ns: int
    travel_m: float
    estimated: bool
