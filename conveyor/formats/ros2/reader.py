"""Reading back a recording that was written as ROS 2 topics in MCAP, with everything that stands beside them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from conveyor.errors import InputError, MessageError
from conveyor.formats.folder.layout import CameraFile, describe
from conveyor.formats.mcap.reader import open_mcap
from conveyor.formats.png16 import Refusal
from conveyor.formats.ros2.layout import METADATA, CameraTopics, topics_of_depth
from conveyor.formats.rosbag.bags import decode_ros
from conveyor.formats.rosbag.depth import FLOAT_ENCODING, depth_pixels
from conveyor.formats.rosbag.messages import RosCompressed, RosImage, RosMessage, plain_type
from conveyor.formats.source import CameraDescription, FrameKey, Refused
from conveyor.messages import Frame
from conveyor.refused import all_in_words


def exported_cameras(path: Path) -> dict[str, tuple[CameraTopics, CameraFile]]:
    """Topics and camera.json of every camera, by name; empty where the file is no export of ours."""
    with open_mcap(path) as reader:
        cameras: dict[str, str] = {}
        for record in reader.iter_metadata():
            if record.name == METADATA:
                cameras.update(record.metadata)
    found = {}
    for depth_topic, text in cameras.items():
        try:
            camera = CameraFile.model_validate(json.loads(text))
        except ValueError as error:
            why = all_in_words(error) if isinstance(error, ValidationError) else error
            raise InputError(f"{path}: what it says about {depth_topic} cannot be used: {why}") from error
        found[camera.name] = (topics_of_depth(depth_topic), camera)
    return found


def cameras_with_frames(path: Path) -> list[str]:
    """Names of the cameras that have any, sorted: one whose frames could all not be read was announced alone."""
    with open_mcap(path) as reader:
        summary = reader.get_summary()
    counts = summary.statistics.channel_message_counts if summary.statistics else {}
    filled = {channel.topic for number, channel in summary.channels.items() if counts.get(number)}
    return sorted(name for name, (topics, _) in exported_cameras(path).items() if topics.depth in filled)


class Ros2ExportSource:
    """One camera of an exported recording: the same frames that were written, number by number."""

    def __init__(self, path: Path, camera: str) -> None:
        self._path = path
        self._topics, file = exported_cameras(path)[camera]
        self._description = describe(file, origin=f"ROS 2 MCAP {path}", frames=len(self.keys()))

    @property
    def description(self) -> CameraDescription:
        """As it was recorded."""
        return self._description

    def keys(self) -> list[FrameKey]:
        """From the depth messages' sequence numbers and log times."""
        with open_mcap(self._path) as reader:
            messages = reader.iter_messages(topics=[self._topics.depth], log_time_order=False)
            return [FrameKey(message.sequence, message.log_time) for _, _, message in messages]

    def frames(self, *, run: str, after: int = -1) -> Iterator[Frame | Refused]:
        """Frames in file order; one that cannot be decoded is refused by its number and the rest goes on."""
        t = self._topics
        beside: dict[str, Any] = {}
        with open_mcap(self._path) as reader:
            wanted = [t.travel, t.mask, t.color, t.depth]
            for schema, channel, message in reader.iter_messages(topics=wanted, log_time_order=False):
                if message.sequence <= after:
                    continue
                beside[channel.topic] = (message.sequence, plain_type(schema.name), message.data)
                if channel.topic == t.depth:
                    parts = {topic: part[1:] for topic, part in beside.items() if part[0] == message.sequence}
                    beside.clear()
                    yield self._frame(parts, message.sequence, message.log_time, run)

    def _frame(self, parts: dict[str, Any], seq: int, captured_ns: int, run: str) -> Frame | Refused:
        d, t = self._description, self._topics
        where = f"frame {seq} of {t.depth} in {self._path}"
        try:
            decoded = {topic: decode_ros(name, data) for topic, (name, data) in parts.items()}
            color, travel = decoded.get(t.color), decoded.get(t.travel)
            return Frame(
                camera=d.name,
                run=run,
                seq=seq,
                captured_ns=captured_ns,
                travel_m=travel if isinstance(travel, float) else None,
                depth_scale_m=d.depth_scale_m,
                intrinsics=d.intrinsics,
                belt_distance_m=d.belt_distance_m,
                depth=_units(decoded[t.depth], d.depth_scale_m),
                belt_from_camera=d.belt_from_camera,
                mask=_units(decoded[t.mask], d.depth_scale_m) if t.mask in decoded else None,
                color_jpeg=np.frombuffer(color.data, np.uint8).copy() if isinstance(color, RosCompressed) else None,
            )
        except MessageError as error:
            return Refused(seq, "undecodable", f"{where}: {error}")


def _units(message: RosMessage, depth_scale_m: float) -> NDArray[np.uint16]:
    """(H, W) uint16, in units of the recording: exactly those that were written."""
    if not isinstance(message, RosImage):
        raise MessageError("it is no image")
    if message.encoding == FLOAT_ENCODING:
        if message.step != 4 * message.width or len(message.data) != message.height * message.step:
            raise MessageError(f"it has {len(message.data)} bytes for {message.height} rows of {message.step}")
        metres = np.frombuffer(message.data, "<f4").reshape(message.height, message.width).astype(np.float64)
        return np.asarray(np.round(metres / depth_scale_m), np.uint16)
    pixels = depth_pixels(message)
    if isinstance(pixels, Refusal):
        raise MessageError(f"it {pixels.text}")
    return pixels
