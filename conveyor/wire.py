"""The wire format: a MessagePack header, then the raw arrays.

    bytes 0-3    magic "TBL" and the schema version
    bytes 4-7    length of the header, little-endian
    header       MessagePack map: {"kind", "fields": {...}, "arrays": [{"name", "dtype", "shape", "codec", "size"}]}
    then         the arrays' bytes, one after the other, in the header's order

Never pickle. Every length is checked before anything is allocated; an unknown version is refused with both versions.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from typing import Any

import msgpack
import numpy as np
import zstandard
from numpy.typing import NDArray

from conveyor.errors import MessageError

SCHEMA_VERSION = 1
MAGIC = b"TBL"
MAX_MESSAGE_BYTES = 64 << 20
MAX_HEADER_BYTES = 4 << 20
MAX_ARRAY_BYTES = 64 << 20
DTYPES = {"u1": np.uint8, "u2": np.uint16, "f4": np.float32, "f8": np.float64}
_PREFIX = struct.Struct("<3sBI")


def pack(
    kind: str, fields: Mapping[str, Any], arrays: Mapping[str, NDArray[Any] | None], *, codec: str = "raw"
) -> bytes:
    """One message as bytes. Arrays that are None are left out. `codec` is 'raw' or 'zstd'."""
    descriptors: list[dict[str, Any]] = []
    chunks: list[bytes] = []
    for name, array in arrays.items():
        if array is None:
            continue
        data = array.tobytes()
        if codec == "zstd":
            data = zstandard.ZstdCompressor(level=1).compress(data)
        descriptors.append(
            {
                "name": name,
                "dtype": array.dtype.str[1:],
                "shape": list(array.shape),
                "codec": codec,
                "size": len(data),
            }
        )
        chunks.append(data)
    header: bytes = msgpack.packb({"kind": kind, "fields": dict(fields), "arrays": descriptors})
    return b"".join([_PREFIX.pack(MAGIC, SCHEMA_VERSION, len(header)), header, *chunks])


def unpack(data: bytes) -> tuple[str, dict[str, Any], dict[str, NDArray[Any]]]:
    """(kind, fields, arrays) of one message. Arrays are read-only views of `data` where the codec is raw.

    Raises:
        MessageError: not a message of ours, of another version, truncated, or larger than allowed.
    """
    if len(data) > MAX_MESSAGE_BYTES:
        raise MessageError(f"message of {len(data)} bytes exceeds the limit of {MAX_MESSAGE_BYTES}")
    if len(data) < _PREFIX.size:
        raise MessageError(f"message of {len(data)} bytes is shorter than its {_PREFIX.size}-byte prefix")
    magic, version, header_size = _PREFIX.unpack_from(data)
    if magic != MAGIC:
        raise MessageError(f"message starts with {magic!r}, not {MAGIC!r}: the sender is not Tuberline")
    if version != SCHEMA_VERSION:
        raise MessageError(
            f"message has schema version {version}, this node speaks version {SCHEMA_VERSION}: "
            "run the same Tuberline release on every machine of the line"
        )
    if header_size > MAX_HEADER_BYTES or _PREFIX.size + header_size > len(data):
        raise MessageError(
            f"header of {header_size} bytes exceeds the message of {len(data)} bytes or the limit of {MAX_HEADER_BYTES}"
        )
    kind, fields, descriptors = _header(data[_PREFIX.size : _PREFIX.size + header_size])
    arrays: dict[str, NDArray[Any]] = {}
    offset = _PREFIX.size + header_size
    for descriptor in descriptors:
        name, array, offset = _array(data, offset, descriptor)
        arrays[name] = array
    if offset != len(data):
        raise MessageError(f"message of kind '{kind}' has {len(data) - offset} bytes after its last array")
    return kind, fields, arrays


def _header(data: bytes) -> tuple[str, dict[str, Any], list[Any]]:
    try:
        header = msgpack.unpackb(
            data, max_str_len=1 << 20, max_array_len=1 << 18, max_map_len=1 << 14, max_bin_len=1 << 20
        )
    except (ValueError, msgpack.UnpackException, RecursionError) as error:
        raise MessageError(f"header is not MessagePack: {error}") from error
    if not isinstance(header, dict):
        raise MessageError(f"header is a {type(header).__name__}, not a map")
    kind, fields, arrays = header.get("kind"), header.get("fields"), header.get("arrays")
    if not (isinstance(kind, str) and isinstance(fields, dict) and isinstance(arrays, list)):
        raise MessageError("header lacks 'kind' (text), 'fields' (map) or 'arrays' (list)")
    if not all(isinstance(field, str) for field in fields):
        raise MessageError(f"header of kind '{kind}' has a field name that is not text")
    return kind, fields, arrays


def _array(data: bytes, offset: int, descriptor: Any) -> tuple[str, NDArray[Any], int]:
    try:
        name, dtype_name = str(descriptor["name"]), descriptor["dtype"]
        shape = tuple(int(n) for n in descriptor["shape"])
        codec, size = descriptor["codec"], int(descriptor["size"])
    except (TypeError, KeyError, ValueError, OverflowError) as error:
        raise MessageError(f"array descriptor {descriptor!r} is not usable: {error!r}") from error
    if not isinstance(dtype_name, str) or dtype_name not in DTYPES:
        raise MessageError(f"array '{name}' has dtype {dtype_name!r}; allowed: {', '.join(DTYPES)}")
    dtype = np.dtype(DTYPES[dtype_name]).newbyteorder("<")
    if len(shape) > 4 or any(n < 0 for n in shape):
        raise MessageError(f"array '{name}' has shape {shape}; allowed are up to 4 sizes of 0 or more")
    expected = math.prod(shape) * dtype.itemsize
    if expected > MAX_ARRAY_BYTES:
        raise MessageError(f"array '{name}' of {expected} bytes exceeds the limit of {MAX_ARRAY_BYTES}")
    if size < 0 or offset + size > len(data):
        raise MessageError(
            f"array '{name}' announces {size} bytes, the message has {len(data) - offset} left: it is truncated"
        )
    chunk: bytes | memoryview = memoryview(data)[offset : offset + size]
    if codec == "zstd":
        chunk = _decompress(bytes(chunk), name=name, expected=expected)
    elif codec != "raw":
        raise MessageError(f"array '{name}' has codec {codec!r}; allowed: raw, zstd")
    if len(chunk) != expected:
        raise MessageError(f"array '{name}' of shape {shape} needs {expected} bytes, got {len(chunk)}")
    return name, np.frombuffer(chunk, dtype=dtype).reshape(shape), offset + size


def _decompress(chunk: bytes, *, name: str, expected: int) -> bytes:
    try:
        announced = zstandard.frame_content_size(chunk)
        if announced != expected:
            raise MessageError(f"array '{name}' decompresses to {announced} bytes, its shape needs {expected}")
        return zstandard.ZstdDecompressor().decompress(chunk, max_output_size=expected)
    except zstandard.ZstdError as error:
        raise MessageError(f"array '{name}' is not valid zstd data: {error}") from error
