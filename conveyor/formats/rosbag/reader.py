"""Reading a depth camera of a ROS 1, ROS 2 or Foxglove bag (.bag, .db3, .mcap or a bag's folder).

Bags of ROS nodes do not store the depth unit: 16-bit depth is taken as millimetres and float depth as metres, as REP
118 prescribes. Files of the RealSense SDK store the unit as an option, and then it is read.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from conveyor.errors import InputError, MessageError
from conveyor.formats.mcap.reader import rate_of
from conveyor.formats.plain.depth import MOST_UNIT_M
from conveyor.formats.png16 import Refusal
from conveyor.formats.rosbag.bags import BagReader, Stored, open_bag
from conveyor.formats.rosbag.depth import (
    FLOAT_ENCODING,
    depth_encoding,
    depth_pixels,
    intrinsics_of,
    unit_m,
    unsupported,
)
from conveyor.formats.rosbag.messages import RosCalibration, RosCompressed, RosImage, RosMessage
from conveyor.formats.rosbag.streams import Stream, depth_streams, first_of, stream_of
from conveyor.formats.source import CameraDescription, FrameKey, Refused
from conveyor.messages import Frame

DISTORTED = 1e-6
"""Distortion coefficients above this say that the image is not rectified."""


def bag_cameras(path: Path) -> tuple[str, ...]:
    """Names of the depth streams in a bag, made from their topics: '/front/depth/image_rect_raw' is 'front'."""
    with open_bag(path) as bag:
        return tuple(stream.camera for stream in depth_streams(path, bag))


class RosBagSource:
    """One depth stream of a bag, numbered in the bag's order. `camera` is its name, or its topic ('/...')."""

    def __init__(self, path: Path, camera: str) -> None:
        self._path = path
        with open_bag(path) as bag:
            self._stream = stream_of(path, bag, camera)
            self._times = [stored.stored_ns for stored in bag.stored(self._stream.images)]
            self._description = self._describe(bag, self._stream)

    @property
    def description(self) -> CameraDescription:
        """From the bag's CameraInfo; bags know no belt distance, so the line's config has to give it."""
        return self._description

    def keys(self) -> list[FrameKey]:
        """Numbers, and the times at which the bag stored the images."""
        return [FrameKey(seq, time) for seq, time in enumerate(self._times)]

    def frames(self, *, run: str, after: int = -1) -> Iterator[Frame | Refused]:
        """Images in the bag's order with their own stamps; one of another kind or size is refused by its number."""
        with open_bag(self._path) as bag:
            for seq, stored in enumerate(bag.stored(self._stream.images)):
                if seq > after:
                    yield self._frame(bag, stored, seq, run)

    def _describe(self, bag: BagReader, stream: Stream) -> CameraDescription:
        where = f"topic {stream.info} in {self._path}"
        info, image = first_of(bag, stream.info), first_of(bag, stream.images, sound=_is_depth)
        if not isinstance(info, RosCalibration):
            raise InputError(f"{where} is no camera info")
        if not isinstance(image, RosImage | RosCompressed):
            raise InputError(f"{self._path}: topic {stream.images} holds no images")
        fault = unsupported(image)
        if fault:
            raise InputError(f"{self._path}: depth topic {stream.images} {fault}")
        self._in_metres = depth_encoding(image) == FLOAT_ENCODING
        unit = first_of(bag, stream.unit) if stream.unit else None
        scale_m = round(unit, 9) if isinstance(unit, float) and not self._in_metres else None
        if scale_m is not None and not 0 < scale_m <= MOST_UNIT_M:
            raise InputError(
                f"{self._path}: topic {stream.unit} says that a unit of depth is {scale_m:g} m; allowed is above 0 to "
                f"{MOST_UNIT_M:g}: record the camera's own again"
            )
        rectified = "rect" in stream.images
        return CameraDescription(
            name=stream.camera,
            origin=f"bag {self._path}, topic {stream.images}, unit {'of REP 118' if scale_m is None else 'stored'}",
            intrinsics=intrinsics_of(info, rectified=rectified, where=where),
            depth_scale_m=unit_m(image) if scale_m is None else scale_m,
            belt_distance_m=None,
            belt_from_camera=None,
            fps=rate_of(self._times),
            frames=len(self._times),
            notes=tuple(_notes(info, stream, rectified=rectified)),
        )

    def _frame(self, bag: BagReader, stored: Stored, seq: int, run: str) -> Frame | Refused:
        d, where = self._description, f"frame {seq} of {self._stream.images} in {self._path}"
        try:
            image = bag.decode(stored)
        except MessageError as error:
            return Refused(seq, "undecodable", f"{where}: {error}")
        if not isinstance(image, RosImage | RosCompressed):
            return Refused(seq, "undecodable", f"{where} is no image")
        if unsupported(image) is None and (depth_encoding(image) == FLOAT_ENCODING) != self._in_metres:
            return Refused(seq, "encoding", f"{where} has encoding '{depth_encoding(image)}', unlike the first image")
        depth = depth_pixels(image)
        if isinstance(depth, Refusal):
            return Refused(seq, depth.reason, f"{where} {depth.text}")
        k = d.intrinsics
        if depth.shape != (k.height, k.width):
            size = f"{depth.shape[1]}x{depth.shape[0]}"
            return Refused(seq, "wrong_size", f"{where} is {size}, its CameraInfo says {k.width}x{k.height}")
        return Frame(
            camera=d.name,
            run=run,
            seq=seq,
            captured_ns=image.stamp_ns or stored.stored_ns,
            travel_m=None,
            depth_scale_m=d.depth_scale_m,
            intrinsics=k,
            belt_distance_m=None,
            depth=depth,
        )


def _is_depth(message: RosMessage) -> bool:
    return isinstance(message, RosImage | RosCompressed) and unsupported(message) is None


def _notes(info: RosCalibration, stream: Stream, *, rectified: bool) -> Iterator[str]:
    if stream.others:
        yield f"depth is on other topics too, not taken: {', '.join(stream.others)} (camera = '<topic>' takes one)"
    if not rectified and any(abs(value) > DISTORTED for value in info.d):
        yield "the CameraInfo has distortion, which is not undone: record the rectified topic"
