"""The few ROS and Foxglove messages that a depth camera sends, as plain values whichever way they were written."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

Kind = Literal["image", "compressed", "calibration", "number", "other"]

KINDS: dict[str, Kind] = {
    "sensor_msgs/msg/Image": "image",
    "sensor_msgs/msg/CompressedImage": "compressed",
    "sensor_msgs/msg/CameraInfo": "calibration",
    "std_msgs/msg/Float32": "number",
    "std_msgs/msg/Float64": "number",
    "foxglove.RawImage": "image",
    "foxglove.CompressedImage": "compressed",
    "foxglove.CameraCalibration": "calibration",
}


@dataclass(frozen=True, slots=True)
class RosImage:
    """An uncompressed image: `data` holds `height` rows of `step` bytes."""

    stamp_ns: int
    encoding: str
    width: int
    height: int
    step: int
    big_endian: bool
    data: bytes


@dataclass(frozen=True, slots=True)
class RosCompressed:
    """A compressed image; `format` as the image transport names it, e.g. '16UC1; compressedDepth png'."""

    stamp_ns: int
    format: str
    data: bytes


@dataclass(frozen=True, slots=True)
class RosCalibration:
    """A camera's calibration: `k` 9 numbers, `p` 12 (or none), row-major, in pixels; `d` distortion coefficients.
    `stamp_ns` is that of the image that it belongs to, 0 where that is not said."""

    width: int
    height: int
    k: tuple[float, ...]
    p: tuple[float, ...]
    d: tuple[float, ...]
    stamp_ns: int = 0


RosMessage = RosImage | RosCompressed | RosCalibration | float


def kind_of(type_name: str) -> Kind:
    """What a message type is to us; ROS 1, ROS 2 and DDS spellings are alike."""
    return KINDS.get(plain_type(type_name), "other")


def plain_type(type_name: str) -> str:
    """'sensor_msgs/Image' and 'sensor_msgs::msg::dds_::Image_' are 'sensor_msgs/msg/Image'."""
    if "::dds_::" in type_name:
        type_name = type_name.replace("::dds_::", "::").rstrip("_").replace("::", "/")
    if type_name.count("/") == 1:
        type_name = type_name.replace("/", "/msg/")
    return type_name


def from_ros(kind: Kind, message: Any) -> RosMessage:
    """The value of a ROS message object, of ROS 1 (`K`, `D`, `P`) or ROS 2 (`k`, `d`, `p`)."""
    if kind == "image":
        return RosImage(
            stamp_ns=_stamp_ns(message),
            encoding=str(message.encoding),
            width=int(message.width),
            height=int(message.height),
            step=int(message.step),
            big_endian=bool(message.is_bigendian),
            data=bytes(message.data),
        )
    if kind == "compressed":
        return RosCompressed(_stamp_ns(message), str(message.format), bytes(message.data))
    if kind == "calibration":
        upper = hasattr(message, "K")
        k, p, d = (getattr(message, name.upper() if upper else name) for name in "kpd")
        size = int(message.width), int(message.height)
        return RosCalibration(*size, _floats(k), _floats(p), _floats(d), _stamp_ns(message))
    return float(message.data)


def _floats(values: Any) -> tuple[float, ...]:
    return tuple(float(value) for value in values)


def _stamp_ns(message: Any) -> int:
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
