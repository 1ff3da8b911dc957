"""MCAP bags of ROS and Foxglove messages, written for tests message by message."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from mcap.writer import Writer
from rosbags.typesys import Stores, get_typestore

from conveyor.formats.rvl import encode_rvl

WIDTH, HEIGHT = 32, 24
START_NS, STEP_NS = 1_700_000_000_000_000_000, 33_333_333
K = (30.0, 0.0, 15.5, 0.0, 31.0, 11.5, 0.0, 0.0, 1.0)
P = (29.0, 0.0, 15.0, 0.0, 0.0, 30.5, 11.0, 0.0, 0.0, 0.0, 1.0, 0.0)
IMAGE, COMPRESSED, INFO = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/CameraInfo"
STORE = get_typestore(Stores.ROS2_HUMBLE)
STORE1 = get_typestore(Stores.ROS1_NOETIC)


def depth_mm(n: int) -> np.ndarray[Any, np.dtype[np.uint16]]:
    """(H, W) uint16, another for every n, with a column of no depth."""
    depth = (np.arange(WIDTH * HEIGHT, dtype=np.uint16).reshape(HEIGHT, WIDTH) % 50 + 400 + n).astype(np.uint16)
    depth[:, 3] = 0
    return depth


def stamp_ns(n: int) -> int:
    """Capture time of image n."""
    return START_NS + n * STEP_NS


def image(
    n: int,
    *,
    encoding: str = "16UC1",
    pad: int = 0,
    big_endian: bool = False,
    ros1: bool = False,
    nearer_mm: int = 0,
    stamp: int | None = None,
) -> bytes:
    """Image n, serialised: metres for 32FC1, else millimetres; `pad` bytes behind each row.

    Its time is that of image `stamp`, where that is given.
    """
    pixels = (np.maximum(depth_mm(n), nearer_mm) - nearer_mm).astype(">u2" if big_endian else "<u2")
    if encoding == "32FC1":
        metres = np.where(depth_mm(n) > 0, depth_mm(n) / 1000.0, np.nan)
        pixels = metres.astype(">f4" if big_endian else "<f4")
    rows = np.full((HEIGHT, pixels.itemsize * WIDTH + pad), 255, np.uint8)
    rows[:, : pixels.itemsize * WIDTH] = pixels.view(np.uint8).reshape(HEIGHT, -1)
    fields = {"height": HEIGHT, "width": WIDTH, "encoding": encoding, "is_bigendian": int(big_endian)}
    at = n if stamp is None else stamp
    return _serialised(IMAGE, {**fields, "step": rows.shape[1], "data": rows.ravel()}, at, ros1=ros1)


def info(
    n: int = 0, *, distortion: float = 0.0, ros1: bool = False, k: tuple[float, ...] = K, p: tuple[float, ...] = P
) -> bytes:
    """The CameraInfo of image n, serialised."""
    types = (STORE1 if ros1 else STORE).types
    names = ("D", "K", "R", "P") if ros1 else ("d", "k", "r", "p")
    matrices = (np.full(5, distortion), np.array(k), np.eye(3).ravel(), np.array(p))
    roi = types["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    fields = {"height": HEIGHT, "width": WIDTH, "distortion_model": "plumb_bob", "binning_x": 0, "binning_y": 0}
    return _serialised(INFO, {**fields, "roi": roi, **dict(zip(names, matrices, strict=True))}, n, ros1=ros1)


def compressed_depth(n: int, *, form: str = "16UC1; compressedDepth png") -> bytes:
    """Image n as compressed_depth_image_transport writes it; float depth as quantised inverse depth.

    Other forms are of the plain transport: the PNG file alone.
    """
    pixels, quant_a, quant_b = depth_mm(n), 0.0, 0.0
    if form.startswith("32FC1"):
        quant_a = 100.0 * 101.0
        quant_b = 1.0 - quant_a / 10.0
        metres = np.maximum(depth_mm(n), 1) / 1000.0
        pixels = np.where(depth_mm(n) > 0, quant_a / metres + quant_b, 0).astype(np.uint16)
    # An RVL blob of the viewer has the transport's twelve bytes before it, as that of ROS.
    packed = encode_rvl(pixels) if form.endswith("rvl") else cv2.imencode(".png", pixels)[1].tobytes()
    header = struct.pack("<iff", 0, quant_a, quant_b) if "compressedDepth" in form else b""
    data = np.frombuffer(header + packed, np.uint8)
    return _serialised(COMPRESSED, {"format": form, "data": data}, n)


def write_mcap(path: Path, channels: dict[str, tuple[str, str, list[bytes]]], *, profile: str = "ros2") -> Path:
    """A file with these topics: name -> (message type, message encoding, messages)."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile)
        for topic, (kind, encoding, messages) in channels.items():
            schema = writer.register_schema(kind, "ros2msg", b"")
            channel = writer.register_channel(topic, encoding, schema)
            for n, data in enumerate(messages):
                writer.add_message(channel, stamp_ns(n) + 5_000, data, stamp_ns(n) + 5_000)
        writer.finish()
    return path


def foxglove_json(n: int) -> tuple[bytes, bytes]:
    """(RawImage n, CameraCalibration) as JSON."""
    stamp = {"sec": stamp_ns(n) // 10**9, "nsec": stamp_ns(n) % 10**9}
    pixels = depth_mm(n).tobytes()
    raw = {"timestamp": stamp, "frame_id": "c", "width": WIDTH, "height": HEIGHT, "encoding": "16UC1"}
    calibration = {"timestamp": stamp, "width": WIDTH, "height": HEIGHT, "D": [], "K": K, "R": [], "P": P}
    image = {**raw, "step": 2 * WIDTH, "data": base64.b64encode(pixels).decode()}
    return json.dumps(image).encode(), json.dumps(calibration).encode()


def foxglove_protobuf(n: int) -> tuple[bytes, bytes]:
    """(RawImage n, CameraCalibration) as protobuf, with a field that no one knows."""
    stamp = _field(1, _varint_field(1, stamp_ns(n) // 10**9) + _varint_field(2, stamp_ns(n) % 10**9))
    size = _fixed(2, WIDTH) + _fixed(3, HEIGHT)
    image = stamp + size + _field(4, b"16UC1") + _fixed(5, 2 * WIDTH) + _field(6, depth_mm(n).tobytes())
    unknown = _field(99, b"x") + _varint_field(98, 7)
    doubles = _field(6, struct.pack("<9d", *K)) + _field(8, struct.pack("<12d", *P))
    return image + _field(7, b"c") + unknown, stamp + size + _field(4, b"plumb_bob") + doubles


def foxglove_compressed(n: int, encoding: str) -> bytes:
    """CompressedImage n: a 16-bit PNG file."""
    png = cv2.imencode(".png", depth_mm(n))[1].tobytes()
    seconds, nanoseconds = divmod(stamp_ns(n), 10**9)
    if encoding == "protobuf":
        stamp = _field(1, _varint_field(1, seconds) + _varint_field(2, nanoseconds))
        return stamp + _field(2, png) + _field(3, b"png") + _field(4, b"c")
    stamp_json = {"sec": seconds, "nsec": nanoseconds}
    return json.dumps({"timestamp": stamp_json, "format": "png", "data": base64.b64encode(png).decode()}).encode()


def _serialised(kind: str, fields: dict[str, Any], n: int, *, ros1: bool = False) -> bytes:
    store = STORE1 if ros1 else STORE
    time = store.types["builtin_interfaces/msg/Time"](sec=stamp_ns(n) // 10**9, nanosec=stamp_ns(n) % 10**9)
    more = {"seq": n} if ros1 else {}
    header = store.types["std_msgs/msg/Header"](stamp=time, frame_id="depth", **more)
    message = store.types[kind](header=header, **fields)
    return bytes(store.serialize_ros1(message, kind) if ros1 else store.serialize_cdr(message, kind))


def _varint(value: int) -> bytes:
    out = b""
    while value > 0x7F:
        out += bytes([value & 0x7F | 0x80])
        value >>= 7
    return out + bytes([value])


def _varint_field(number: int, value: int) -> bytes:
    return _varint(number << 3) + _varint(value)


def _field(number: int, data: bytes) -> bytes:
    return _varint(number << 3 | 2) + _varint(len(data)) + data


def _fixed(number: int, value: int) -> bytes:
    return _varint(number << 3 | 5) + struct.pack("<I", value)
