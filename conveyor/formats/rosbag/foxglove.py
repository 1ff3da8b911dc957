"""Foxglove's own image messages, written as JSON or as protobuf; only the fields a depth camera needs.

Field numbers are those of the published schemas foxglove/RawImage.proto, CompressedImage.proto and
CameraCalibration.proto; the protobuf wire format is simple enough to be read without a library for it.
"""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Iterator
from typing import Any

from conveyor.errors import MessageError
from conveyor.formats.rosbag.messages import Kind, RosCalibration, RosCompressed, RosImage, RosMessage

Fields = dict[int, list[Any]]


def from_json(kind: Kind, data: bytes) -> RosMessage:
    """The value of a JSON message.

    Raises:
        MessageError: not such a message.
    """
    try:
        raw = json.loads(data)
        stamp = raw.get("timestamp", {})
        stamp_ns = _stamp_ns(int(stamp.get("sec", 0)), int(stamp.get("nsec", 0)))
        if kind == "calibration":
            k, p, d = (tuple(map(float, raw.get(name, ()))) for name in "KPD")
            return RosCalibration(_size(raw["width"]), _size(raw["height"]), k, p, d)
        pixels = base64.b64decode(raw["data"], validate=True)
        if kind == "compressed":
            return RosCompressed(stamp_ns, str(raw["format"]), pixels)
        size = _size(raw["width"]), _size(raw["height"])
        return RosImage(stamp_ns, str(raw["encoding"]), *size, _size(raw["step"]), False, pixels)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError) as error:
        raise MessageError(f"no JSON message of Foxglove's {kind} schema: {error!r}") from error


def from_protobuf(kind: Kind, data: bytes) -> RosMessage:
    """The value of a protobuf message.

    Raises:
        MessageError: not such a message.
    """
    try:
        fields = _fields(data)
        if kind == "calibration":
            k, p, d = (_doubles(fields, number) for number in (6, 8, 5))
            return RosCalibration(_fixed32(fields, 2), _fixed32(fields, 3), k, p, d)
        stamp = _fields(_bytes(fields, 1))
        stamp_ns = _stamp_ns(_last(stamp, 1, 0), _last(stamp, 2, 0))
        if kind == "compressed":
            return RosCompressed(stamp_ns, _bytes(fields, 3).decode(), _bytes(fields, 2))
        size = _fixed32(fields, 2), _fixed32(fields, 3)
        return RosImage(stamp_ns, _bytes(fields, 4).decode(), *size, _fixed32(fields, 5), False, _bytes(fields, 6))
    except (ValueError, IndexError, TypeError, struct.error) as error:
        raise MessageError(f"no protobuf message of Foxglove's {kind} schema: {error!r}") from error


def _stamp_ns(seconds: int, nanoseconds: int) -> int:
    """What a frame can carry: 64 bits."""
    stamp_ns = seconds * 1_000_000_000 + nanoseconds
    if not 0 <= stamp_ns < 1 << 63:
        raise ValueError(f"a time of {seconds} s")
    return stamp_ns


def _size(value: Any) -> int:
    """A field of 32 bits in the schema, whatever JSON can say."""
    size = int(value)
    if not 0 <= size < 1 << 32:
        raise ValueError("a size beyond 32 bits")
    return size


def _fields(data: bytes) -> Fields:
    """All fields by number: varints as int, everything else as its bytes."""
    fields: Fields = {}
    for number, value in _walk(data):
        fields.setdefault(number, []).append(value)
    return fields


def _walk(data: bytes) -> Iterator[tuple[int, int | bytes]]:
    at = 0
    while at < len(data):
        tag, at = _varint(data, at)
        wire, number = tag & 7, tag >> 3
        if wire == 0:
            value, at = _varint(data, at)
            yield number, value
            continue
        if wire == 2:
            length, at = _varint(data, at)
        elif wire in (1, 5):
            length = 8 if wire == 1 else 4
        else:
            raise ValueError(f"wire type {wire}")
        if at + length > len(data):
            raise ValueError(f"field {number} is cut: {length} bytes wanted, {len(data) - at} left")
        yield number, data[at : at + length]
        at += length


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return value, at
        if shift > 63:
            raise ValueError("varint of more than 64 bits")


def _last(fields: Fields, number: int, default: Any) -> Any:
    return fields[number][-1] if number in fields else default


def _bytes(fields: Fields, number: int) -> bytes:
    value = _last(fields, number, b"")
    if not isinstance(value, bytes):
        raise ValueError(f"field {number} is a number")
    return value


def _fixed32(fields: Fields, number: int) -> int:
    return int(struct.unpack("<I", _last(fields, number, b"\0\0\0\0"))[0])


def _doubles(fields: Fields, number: int) -> tuple[float, ...]:
    """Repeated doubles, packed or one by one."""
    data = b"".join(fields.get(number, []))
    return struct.unpack(f"<{len(data) // 8}d", data)
