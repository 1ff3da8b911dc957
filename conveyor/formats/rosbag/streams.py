"""Which topics of a bag are depth cameras: one stream a camera, named by its topics.

A camera often publishes its depth several times: as it was measured, aligned to colour, compressed. One of them is
taken (uncompressed before compressed, as measured before aligned); the others are named and can be asked for by topic.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from conveyor.errors import InputError, MessageError
from conveyor.formats.rosbag.bags import BagReader, Topic
from conveyor.formats.rosbag.depth import SHORT_ENCODINGS, depth_encoding, unsupported
from conveyor.formats.rosbag.messages import RosCompressed, RosImage, RosMessage

DEPTH_TYPES = "sensor_msgs/msg/Image, sensor_msgs/msg/CompressedImage (compressedDepth), foxglove.RawImage"
_COLOUR = ("color", "colour", "rgb")
"""CameraInfo of such topics is of depth only where that was aligned to colour; infrared images share depth's."""
_ALIGNED = (*_COLOUR, "aligned", "registered")
_NO_DEPTH = (*_COLOUR, "infra")
"""Images of such topics may have 16 bits and still be no depth."""
_UNITS = re.compile(r"depth.units", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Stream:
    """A depth camera of a bag: its image topic, the topics of its intrinsics and (or None) of its depth unit.

    `others` are depth topics of the same camera that were not taken.
    """

    camera: str
    images: str
    info: str
    unit: str | None
    others: tuple[str, ...] = ()


def depth_streams(path: Path, bag: BagReader) -> list[Stream]:
    """The depth cameras of a bag, sorted by topic.

    Raises:
        InputError: none, or one without intrinsics; the text lists the topics there are.
    """
    by_camera: dict[str, list[str]] = {}
    for topic in _depth_topics(bag):
        by_camera.setdefault(camera_name(topic), []).append(topic)
    if not by_camera:
        raise InputError(f"{path} has no depth image topic (of {DEPTH_TYPES}); its topics: {listing(bag)}")
    streams = []
    for camera, topics in by_camera.items():
        best, *others = sorted(topics, key=_preference)
        streams.append(_stream(path, bag, camera, best, tuple(others)))
    return streams


def stream_of(path: Path, bag: BagReader, camera: str) -> Stream:
    """The stream named `camera`, or of the depth topic `camera`.

    Raises:
        InputError: no such camera or topic.
    """
    if camera.startswith("/"):
        if camera not in [topic.name for topic in bag.topics]:
            raise InputError(f"{path} has no topic {camera}; its topics: {listing(bag)}")
        return _stream(path, bag, camera_name(camera), camera, ())
    streams = depth_streams(path, bag)
    found = next((stream for stream in streams if stream.camera == camera), None)
    if found is None:
        raise InputError(f"{path} has no camera '{camera}'; known: {', '.join(s.camera for s in streams)}")
    return found


def listing(bag: BagReader) -> str:
    """All topics with their types."""
    return ", ".join(f"{topic.name} ({topic.type_name})" for topic in bag.topics) or "none"


def camera_name(topic: str) -> str:
    """'/front/depth/image_rect_raw' is 'front', '/camera/camera/aligned_depth_to_color/image_raw' is 'camera'."""
    before: list[str] = []
    for part in topic.strip("/").split("/"):
        if "depth" in part.lower():
            break
        if part not in before:
            before.append(part)
    else:
        before = before[:-1]
    return re.sub(r"[^A-Za-z0-9._-]", "_", "-".join(before)).lstrip("._-")[:64] or "depth"


def nearest(topic: str, others: list[str]) -> str | None:
    """The one of `others` that shares the longest path with `topic`, at least its first part."""
    parts = topic.split("/")

    def shared(other: str) -> int:
        both = zip(parts, other.split("/"), strict=False)
        return next((n for n, (a, b) in enumerate(both) if a != b), len(parts))

    best = max(sorted(others), key=shared, default=None)
    return best if best is not None and shared(best) >= 2 else None


def first_of(bag: BagReader, topic: str, *, sound: Callable[[RosMessage], bool] = lambda message: True) -> RosMessage:
    """The first message of a topic that can be decoded and is `sound`; where none is, the first that can be decoded.
    A damaged one says nothing of the topic: it is one frame that is missing.

    Raises:
        InputError: there is none, or none can be decoded.
    """
    first, fault = None, None
    for stored in bag.stored(topic):
        try:
            message = bag.decode(stored)
        except MessageError as error:
            fault = fault or error
            continue
        if sound(message):
            return message
        first = first or message
    if first is not None:
        return first
    if fault is not None:
        raise InputError(f"no message on {topic} can be decoded; the first: {fault}") from fault
    raise InputError(f"topic {topic} has no message, though the bag's index counts some")


def _depth_topics(bag: BagReader) -> list[str]:
    """Topics named after depth; where there are none, images whose first one is of a depth encoding."""
    images = [topic for topic in bag.topics if topic.kind == "image"]
    compressed = [topic for topic in bag.topics if topic.kind == "compressed"]
    named = [topic.name for topic in images if "depth" in topic.name.lower()]
    named += [t.name for t in compressed if "depth" in t.name.lower() and unsupported(_first_image(bag, t)) is None]
    if named:
        return sorted(named)
    images = [topic for topic in images if not _has(topic.name, _NO_DEPTH)]
    found = [topic.name for topic in images if _is_depth(_first_image(bag, topic))]
    return sorted(found + [topic.name for topic in compressed if unsupported(_first_image(bag, topic)) is None])


def _is_depth(image: RosImage | RosCompressed) -> bool:
    """'mono16' is what infrared cameras send too, so by itself it is no depth."""
    return unsupported(image) is None and depth_encoding(image) != SHORT_ENCODINGS[1]


def _first_image(bag: BagReader, topic: Topic) -> RosImage | RosCompressed:
    message = first_of(bag, topic.name)
    if not isinstance(message, RosImage | RosCompressed):
        raise InputError(f"topic {topic.name} holds {topic.type_name}, no images")
    return message


def _preference(topic: str) -> tuple[bool, bool, str]:
    return topic.endswith("compressedDepth"), "aligned" in topic, topic


def _same_lens(images: str, info: str) -> bool:
    """Whether the intrinsics of `info` can be those of the depth images."""
    return _has(images, _ALIGNED) or not _has(info, _COLOUR)


def _has(topic: str, words: tuple[str, ...]) -> bool:
    return any(word in topic.lower() for word in words)


def _stream(path: Path, bag: BagReader, camera: str, images: str, others: tuple[str, ...]) -> Stream:
    infos = [topic.name for topic in bag.topics if topic.kind == "calibration"]
    info = nearest(images, [info for info in infos if _same_lens(images, info)])
    if info is None:
        known = f"; camera infos there are: {', '.join(infos)}" if infos else f"; its topics: {listing(bag)}"
        raise InputError(
            f"{path}: depth topic {images} has no CameraInfo topic beside it, so its intrinsics are unknown. "
            f"Record {images.removesuffix('/compressedDepth').rpartition('/')[0]}/camera_info too{known}"
        )
    units = [topic.name for topic in bag.topics if topic.kind == "number" and _UNITS.search(topic.name)]
    return Stream(camera, images, info, nearest(images, units), others)
