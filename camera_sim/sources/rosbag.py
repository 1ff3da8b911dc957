"""Reading depth images from ROS 1 and ROS 2 bags (.bag, .db3, .mcap or a bag's folder), RealSense recordings included.

Bags of ROS nodes do not store the depth unit: 1 mm is taken, as REP 118 prescribes for 16-bit depth. Files of the
RealSense SDK store it as an option, and then it is read.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camera_sim.sources.base import CameraDescription, FrameKey, Refused
from conveyor.errors import InputError
from conveyor.geometry import Intrinsics
from conveyor.messages import Frame

IMAGE, CAMERA_INFO, FLOAT = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo", "std_msgs/msg/Float32"
DEPTH_ENCODINGS = ("16UC1", "mono16", "Z16")
REP_118_UNIT_M = 0.001


@dataclass(frozen=True, slots=True)
class _Stream:
    """A depth stream: its image topic, the topic of its intrinsics, and that of its depth unit where there is one."""

    camera: str
    images: str
    info: str
    unit: str | None


def bag_cameras(path: Path) -> tuple[str, ...]:
    """Names of the depth streams in a bag, made from their topics: '/front/depth/image_rect_raw' is 'front'."""
    with _open(path) as bag:
        return tuple(stream.camera for stream in _streams(path, bag))


class RosBagSource:
    """One depth stream of a bag, numbered in the bag's order."""

    def __init__(self, path: Path, camera: str) -> None:
        self._path = path
        with _open(path) as bag:
            self._stream = next(stream for stream in _streams(path, bag) if stream.camera == camera)
            info = _first(bag, self._stream.info)
            unit = _first(bag, self._stream.unit) if self._stream.unit else None
            times = [t for _, t, _ in bag.messages(_connections(bag, self._stream.images))]
        matrix = info.K if hasattr(info, "K") else info.k
        k = Intrinsics(info.width, info.height, float(matrix[0]), float(matrix[4]), float(matrix[2]), float(matrix[5]))
        steps = np.diff(np.asarray(times, np.int64))
        self._times = times
        self._description = CameraDescription(
            name=camera,
            origin=f"ROS bag {path}, topic {self._stream.images}, unit {'stored' if unit else 'of REP 118'}",
            intrinsics=k,
            depth_scale_m=round(float(unit.data), 9) if unit else REP_118_UNIT_M,
            belt_distance_m=None,
            belt_from_camera=None,
            fps=round(1e9 / float(np.median(steps)), 3) if len(steps) and np.median(steps) > 0 else 30.0,
            frames=len(times),
        )

    @property
    def description(self) -> CameraDescription:
        """From the bag's CameraInfo; bags know no belt distance, so the line's config has to give it."""
        return self._description

    def keys(self) -> list[FrameKey]:
        """Numbers, and the times at which the bag stored the images."""
        return [FrameKey(seq, time) for seq, time in enumerate(self._times)]

    def frames(self, *, run: str, after: int = -1) -> Iterator[Frame | Refused]:
        """Images in the bag's order with their own stamps; one of another kind or size is refused by its number."""
        with _open(self._path) as bag:
            messages = bag.messages(_connections(bag, self._stream.images))
            for seq, (connection, stored_ns, raw) in enumerate(messages):
                if seq > after:
                    yield self._frame(seq, bag.deserialize(raw, connection.msgtype), stored_ns, run)

    def _frame(self, seq: int, image: Any, stored_ns: int, run: str) -> Frame | Refused:
        d, where = self._description, f"frame {seq} of {self._stream.images} in {self._path}"
        if image.encoding not in DEPTH_ENCODINGS:
            known = ", ".join(DEPTH_ENCODINGS)
            return Refused(seq, "encoding", f"{where} has encoding '{image.encoding}'; depth is read from {known}")
        if (image.height, image.width) != (d.intrinsics.height, d.intrinsics.width):
            size = f"{d.intrinsics.width}x{d.intrinsics.height}"
            return Refused(seq, "wrong_size", f"{where} is {image.width}x{image.height}, its CameraInfo says {size}")
        if len(image.data) < image.height * image.step or image.step < 2 * image.width:
            return Refused(seq, "truncated", f"{where} has {len(image.data)} bytes, {image.height} rows need more")
        stamp = image.header.stamp
        stamp_ns = int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
        return Frame(
            camera=d.name,
            run=run,
            seq=seq,
            captured_ns=stamp_ns or stored_ns,
            travel_m=None,
            depth_scale_m=d.depth_scale_m,
            intrinsics=d.intrinsics,
            belt_distance_m=None,
            depth=_pixels(image),
        )


def _pixels(image: Any) -> NDArray[np.uint16]:
    rows = np.frombuffer(bytes(image.data), np.uint8)[: image.height * image.step].reshape(image.height, image.step)
    pixels = np.ascontiguousarray(rows[:, : 2 * image.width]).view(">u2" if image.is_bigendian else "<u2")
    return pixels.astype(np.uint16)


def _streams(path: Path, bag: Any) -> list[_Stream]:
    types = {connection.topic: connection.msgtype for connection in bag.connections if connection.msgcount}
    infos = [topic for topic, kind in types.items() if kind == CAMERA_INFO]
    units = [topic for topic, kind in types.items() if kind == FLOAT and re.search(r"depth.units", topic, re.I)]
    streams: list[_Stream] = []
    for topic in sorted(topic for topic, kind in types.items() if kind == IMAGE and "depth" in topic.lower()):
        info = _nearest(topic, infos)
        if info is None:
            raise InputError(f"{path}: depth topic {topic} has no CameraInfo topic beside it: intrinsics are unknown")
        name = _camera_name(topic)
        taken = [stream.camera for stream in streams]
        streams.append(
            _Stream(name if name not in taken else f"{name}-{len(taken)}", topic, info, _nearest(topic, units))
        )
    if not streams:
        raise InputError(f"{path} has no depth image topic ({IMAGE} with 'depth' in its name); topics: {sorted(types)}")
    return streams


def _nearest(topic: str, others: list[str]) -> str | None:
    """The one of `others` that shares the longest path with `topic`, at least its first part."""
    parts = topic.split("/")

    def shared(other: str) -> int:
        both = zip(parts, other.split("/"), strict=False)
        return next((n for n, (a, b) in enumerate(both) if a != b), len(parts))

    best = max(sorted(others), key=shared, default=None)
    return best if best is not None and shared(best) >= 2 else None


def _camera_name(topic: str) -> str:
    before: list[str] = []
    for part in topic.strip("/").split("/"):
        if "depth" in part.lower():
            break
        if part not in before:
            before.append(part)
    return re.sub(r"[^A-Za-z0-9._-]", "_", "-".join(before)) or "depth"


def _connections(bag: Any, topic: str) -> list[Any]:
    return [connection for connection in bag.connections if connection.topic == topic]


def _first(bag: Any, topic: str) -> Any:
    connection, _, raw = next(iter(bag.messages(_connections(bag, topic))))
    return bag.deserialize(raw, connection.msgtype)


@contextmanager
def _open(path: Path) -> Iterator[Any]:
    """The library's reader, its errors as ours."""
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise InputError(
            f"reading ROS bags needs the package rosbags ({error}): pip install 'tuberline[bags]'"
        ) from error
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as bag:
            yield bag
    except AnyReaderError as error:
        raise InputError(f"{path} is no ROS bag that can be read: {error}") from error
