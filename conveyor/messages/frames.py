"""What a camera sends, and what it is told back."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import MessageError
from conveyor.geometry import MAX_SIDE_PIXELS, Intrinsics
from conveyor.messages.base import ArraySpec, Message
from conveyor.ranges import (
    MAX_COUNT,
    BeltDistance,
    BeltPlace,
    Count,
    Counts,
    DepthScale,
    Line,
    Name,
    Nanoseconds,
    Range,
    Seq,
    Word,
    Yes,
)
from conveyor.wire import MAX_ARRAY_BYTES, MAX_MESSAGE_BYTES

IMAGE_SIDES = ((1, MAX_SIDE_PIXELS), (1, MAX_SIDE_PIXELS))
POSE = ArraySpec("f8", ((4, 4), (4, 4)), low=-1000.0, high=1000.0, unit="m")
"""A rigid transform: cosines, and metres from here to the other end of a hall."""
OPTIONAL_POSE = replace(POSE, optional=True)
SeqOrNone = Annotated[int, Range(-1, MAX_COUNT, "frames")]
"""Number of a frame, or -1: none yet."""


@dataclass(frozen=True, slots=True)
class Frame(Message):
    """One depth image with everything needed to read it.

    Attributes:
        camera: name of the camera; `run`: id of this run of the line.
        seq: sequence number per camera and run; a gap means a lost frame.
        after_seq: number of the frame that a camera that waits sent before this one (-1: none): a segmenter that
            has not got that one waits for it, so that what a link lost, or delivers late, is no gap. None where no one
            waits.
        captured_ns: capture time, nanoseconds of the camera's clock.
        travel_m: belt travel at capture from an encoder, metres; None where it must be estimated.
        depth: (H, W) uint16, units of `depth_scale_m` metres, 0 = no depth.
        belt_distance_m: camera to belt along the optical axis, metres, or None if not calibrated.
        belt_from_camera: (4, 4) float64 rigid transform, or None: straight down at `belt_distance_m`.
        mask: (H, W) uint16 given instance labels, 0 = background, or None.
        color_jpeg: (n,) uint8, a JPEG file aligned to the depth image, or None.
    """

    camera: Name
    run: Name
    seq: Seq
    captured_ns: Nanoseconds
    travel_m: BeltPlace | None
    depth_scale_m: DepthScale
    intrinsics: Intrinsics
    belt_distance_m: BeltDistance | None
    depth: NDArray[np.uint16]
    belt_from_camera: NDArray[np.float64] | None = None
    mask: NDArray[np.uint16] | None = None
    color_jpeg: NDArray[np.uint8] | None = None
    after_seq: SeqOrNone | None = None

    ARRAYS: ClassVar[dict[str, ArraySpec]] = {
        "depth": ArraySpec("u2", IMAGE_SIDES),
        "belt_from_camera": OPTIONAL_POSE,
        "mask": ArraySpec("u2", IMAGE_SIDES, optional=True),
        "color_jpeg": ArraySpec("u1", ((0, MAX_ARRAY_BYTES),), optional=True),
    }

    def __post_init__(self) -> None:
        size = (self.intrinsics.height, self.intrinsics.width)
        for name, array in (("depth", self.depth), ("mask", self.mask)):
            if array is not None and array.shape != size:
                raise MessageError(f"Frame.{name} is {array.shape}, the intrinsics are for {size} (rows, columns)")
        if self.belt_from_camera is not None and self.belt_from_camera.shape != (4, 4):
            raise MessageError(f"Frame.belt_from_camera is {self.belt_from_camera.shape}, not (4, 4)")


@dataclass(frozen=True, slots=True)
class FrameSlot(Message):
    """Where an encoded `Frame` lies in the memory that a camera shares with its segmenter (`conveyor.frame_ring`).

    `ring`: the ring's id; `slot`: which of its places; `generation`: how often it was written, twice; `size`: bytes.
    """

    ring: Count
    slot: Annotated[int, Range(0, 1023, "")]
    generation: Count
    size: Annotated[int, Range(1, MAX_MESSAGE_BYTES, "bytes")]


@dataclass(frozen=True, slots=True)
class CameraInfo(Message):
    """What a camera is and how far it got. `state` 'ended' is the last word of a recording.

    `published` counts frames put on the wire, `last_seq` is the newest sequence number; `first_seq` the first one
    of the run. `waits` says that the camera waits for the segmenter's progress and so loses nothing (a replay).
    `refused` counts frames the source could not read, by reason; their sequence numbers are gaps downstream.
    `first_captured_ns`, `first_travel_m`, `last_captured_ns`, `last_travel_m` are of the first and the newest frame
    published by this process (None before the first; no travel without an encoder): belt that passed between them and
    was not processed was not seen. `live`: a device, whose belt may have moved before its first frame. `serial`: its
    serial number; None where the source knows none.
    """

    camera: Name
    run: Name
    state: Literal["starting", "streaming", "ended", "failed"]
    source: Line
    fps: Annotated[float, Range(0, 10_000, "frames/s")]
    waits: Yes
    intrinsics: Intrinsics
    depth_scale_m: DepthScale
    first_seq: Seq | None
    last_seq: Seq | None
    published: Count
    refused: Counts
    error: Line = ""
    first_captured_ns: Nanoseconds | None = None
    first_travel_m: BeltPlace | None = None
    last_captured_ns: Nanoseconds | None = None
    last_travel_m: BeltPlace | None = None
    live: Yes = False
    serial: Word | None = None


@dataclass(frozen=True, slots=True)
class FrameProgress(Message):
    """The segmenter is done with all frames up to `done_seq` (-1: none yet) and takes `window` more."""

    camera: Name
    run: Name
    done_seq: SeqOrNone
    window: Annotated[int, Range(0, 1024, "frames")]


@dataclass(frozen=True, slots=True)
class Travel(Message):
    """How far the belt has moved since the run started, metres, at `captured_ns`."""

    source: Name
    run: Name
    captured_ns: Nanoseconds
    travel_m: BeltPlace
    estimated: Yes
