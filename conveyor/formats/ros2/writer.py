"""Writing a recording as ROS 2 topics in MCAP (layout: `conveyor.formats.ros2.layout`)."""

from __future__ import annotations

import json
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

import numpy as np
from mcap.writer import CompressionType, Writer

from conveyor import __version__
from conveyor.errors import InputError
from conveyor.formats.folder.layout import camera_json
from conveyor.formats.mcap.layout import FORMAT_METADATA, FORMAT_VERSION
from conveyor.formats.mcap.writer import CHUNK_BYTES, open_new
from conveyor.formats.ros2.layout import METADATA, MILLIMETRE_M, PROFILE, CameraTopics, topics_of_camera
from conveyor.formats.rosbag.bags import ros2_typestore
from conveyor.formats.source import CameraDescription
from conveyor.geometry import Intrinsics
from conveyor.messages import Frame

IMAGE, COMPRESSED, INFO = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/CameraInfo"
FLOAT = "std_msgs/msg/Float64"
LAST_S = 2**31 - 1
"""Of builtin_interfaces/msg/Time."""


class Ros2McapWriter:
    """Frames of any number of cameras in one file; use it in a `with`. The file must not exist yet."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._store = ros2_typestore()
        self._cameras: dict[str, dict[str, Any]] = {}
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._file: IO[bytes] | None = None
        self._writer: Any = None

    def __enter__(self) -> Self:
        self._file = open_new(self._path)
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile=PROFILE, library=f"tuberline {__version__}")
        self._writer.add_metadata(FORMAT_METADATA, {"version": str(FORMAT_VERSION)})
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        cameras = {topics_of_camera(name).depth: json.dumps(camera) for name, camera in self._cameras.items()}
        self._writer.add_metadata(METADATA, cameras)
        self._writer.finish()
        if self._file is not None:
            self._file.close()

    def add_camera(self, description: CameraDescription) -> None:
        """Announce a camera; needed before its first frame.

        Raises:
            InputError: another camera has the same name in ROS.
        """
        name = description.name
        for other in self._cameras:
            if topics_of_camera(other) == topics_of_camera(name):
                raise InputError(f"cameras '{other}' and '{name}' have the same name in ROS: rename one of them")
        self._cameras[name] = camera_json(description)

    def attach(self, name: str, data: bytes) -> None:
        """Add a file that belongs to the recording: JSON, or a table."""
        kind = "text/csv" if name.endswith(".csv") else "application/json"
        self._writer.add_attachment(create_time=0, log_time=0, name=name, media_type=kind, data=data)

    def write(self, frame: Frame) -> None:
        """Append `frame`: travel, mask, colour and calibration first, its depth last.

        Raises:
            InputError: it was captured after what a ROS 2 time can say.
        """
        topics = topics_of_camera(frame.camera)
        header = self._header(frame, topics)
        if frame.travel_m is not None:
            self._put(topics.travel, FLOAT, self._type(FLOAT)(data=float(frame.travel_m)), frame)
        if frame.mask is not None:
            self._put(topics.mask, IMAGE, self._image(header, frame.mask, "mono16"), frame)
        if frame.color_jpeg is not None:
            color = self._type(COMPRESSED)(header=header, format="rgb8; jpeg compressed bgr8", data=frame.color_jpeg)
            self._put(topics.color, COMPRESSED, color, frame)
        self._put(topics.info, INFO, self._info(header, frame.intrinsics), frame)
        if abs(frame.depth_scale_m - MILLIMETRE_M) < 1e-12:
            depth = self._image(header, frame.depth, "16UC1")
        else:
            depth = self._image(header, (frame.depth * frame.depth_scale_m).astype(np.float32), "32FC1")
        self._put(topics.depth, IMAGE, depth, frame)

    def _type(self, name: str) -> Any:
        return self._store.types[name]

    def _header(self, frame: Frame, topics: CameraTopics) -> Any:
        seconds, nanoseconds = divmod(frame.captured_ns, 1_000_000_000)
        if seconds > LAST_S:
            raise InputError(
                f"{self._path}: frame {frame.seq} of camera '{frame.camera}' was captured at {seconds} s; a ROS 2 time "
                f"ends at {LAST_S} s, in 2038: set the camera's clock, or write another format"
            )
        stamp = self._type("builtin_interfaces/msg/Time")(sec=seconds, nanosec=nanoseconds)
        return self._type("std_msgs/msg/Header")(stamp=stamp, frame_id=topics.frame_id)

    def _image(self, header: Any, pixels: np.ndarray[Any, Any], encoding: str) -> Any:
        rows = np.ascontiguousarray(pixels.astype(pixels.dtype.newbyteorder("<"), copy=False))
        return self._type(IMAGE)(
            header=header,
            height=pixels.shape[0],
            width=pixels.shape[1],
            encoding=encoding,
            is_bigendian=0,
            step=pixels.shape[1] * pixels.itemsize,
            data=rows.view(np.uint8).ravel(),
        )

    def _info(self, header: Any, k: Intrinsics) -> Any:
        roi = self._type("sensor_msgs/msg/RegionOfInterest")(
            x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        )
        return self._type(INFO)(
            header=header,
            height=k.height,
            width=k.width,
            distortion_model="plumb_bob",
            d=np.zeros(5),
            k=np.array([k.fx, 0, k.cx, 0, k.fy, k.cy, 0, 0, 1.0]),
            r=np.eye(3).ravel(),
            p=np.array([k.fx, 0, k.cx, 0, 0, k.fy, k.cy, 0, 0, 0, 1.0, 0]),
            binning_x=0,
            binning_y=0,
            roi=roi,
        )

    def _put(self, topic: str, type_name: str, message: Any, frame: Frame) -> None:
        if type_name not in self._schemas:
            text = self._store.generate_msgdef(type_name, ros_version=2)[0]
            self._schemas[type_name] = self._writer.register_schema(type_name, "ros2msg", text.encode())
        if topic not in self._channels:
            self._channels[topic] = self._writer.register_channel(topic, "cdr", self._schemas[type_name])
        self._writer.add_message(
            channel_id=self._channels[topic],
            log_time=frame.captured_ns,
            publish_time=frame.captured_ns,
            sequence=frame.seq,
            data=bytes(self._store.serialize_cdr(message, type_name)),
        )
