"""The wire format: a MessagePack header, then the raw arrays.

    bytes 0-3    magic "TBL" and the schema version
    bytes 4-7    length of the header, little-endian
    header       MessagePack map: {"kind", "fields": {...}, "arrays": [{"name", "dtype", "shape", "codec", "size"}]}
    then         the arrays' bytes, one after the other, in the header's order

Never pickle. Every length is checked, on its own and together with the others, against the bytes that really follow
and in Python's whole numbers, before anything is allocated; an unknown version is refused with both versions. Reading
takes at most `MAX_ARRAY_BYTES`, and 80 times the header's length for its values (an empty map is one byte of it).
"""

from __future__ import annotations

import math
import reprlib
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import msgpack
import numpy as np
import zstandard
from numpy.typing import NDArray

from conveyor.errors import MessageError, Refusal
from conveyor.ranges import INT64_MAX

SCHEMA_VERSION = 1
MAGIC = b"TBL"
MAX_MESSAGE_BYTES = 64 << 20
MAX_HEADER_BYTES = 1 << 20
MAX_ARRAY_BYTES = 64 << 20
"""Of all arrays of one message together, as they are in memory."""
MAX_ARRAYS = 8
MAX_DIMENSIONS = 4
MAX_NESTING = 8
"""Maps and lists within each other; a flag of a view of a track of an entry lies 6 deep."""
MAX_ITEMS = 1 << 15
"""Of all lists and maps of a header together."""
MAX_TEXT_BYTES = 256 << 10
DTYPES = {"u1": np.uint8, "u2": np.uint16, "f4": np.float32, "f8": np.float64}
_PREFIX = struct.Struct("<3sBI")
_SHOWN = reprlib.Repr()
_SHOWN.maxlevel, _SHOWN.maxstring, _SHOWN.maxother = 2, 80, 80


@dataclass(frozen=True, slots=True)
class Announced:
    """An array as its header announces it, checked against the message's length; its bytes are `at` to `at + size`."""

    name: str
    dtype: str
    shape: tuple[int, ...]
    codec: str
    at: int
    size: int

    @property
    def bytes(self) -> int:
        """Bytes it has in memory."""
        return math.prod(self.shape) * np.dtype(DTYPES[self.dtype]).itemsize


@dataclass(frozen=True, slots=True)
class Header:
    """A message whose arrays are not read yet."""

    kind: str
    fields: dict[str, Any]
    arrays: tuple[Announced, ...]


def pack(
    kind: str, fields: Mapping[str, Any], arrays: Mapping[str, NDArray[Any] | None], *, codec: str = "raw"
) -> bytes:
    """One message as bytes. Arrays that are None are left out. `codec` is 'raw' or 'zstd'."""
    descriptors: list[dict[str, Any]] = []
    chunks: list[bytes | memoryview] = []
    for name, array in arrays.items():
        if array is None:
            continue
        # As it lies in the memory, where that is how it travels: the message is the only copy.
        flat: Any = array.reshape(-1).view(np.uint8)
        data: bytes | memoryview = memoryview(flat) if array.size else b""
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
    header = read_header(data)
    return header.kind, header.fields, {array.name: read_array(data, array) for array in header.arrays}


def read_header(data: bytes) -> Header:
    """What a message says of itself, everything checked that can be without reading its arrays.

    Raises:
        MessageError: see `unpack`.
    """
    if len(data) > MAX_MESSAGE_BYTES:
        raise MessageError(
            f"message of {len(data)} bytes exceeds the limit of {MAX_MESSAGE_BYTES}", reason=Refusal.SIZE
        )
    if len(data) < _PREFIX.size:
        raise MessageError(
            f"message of {len(data)} bytes is shorter than its {_PREFIX.size}-byte prefix", reason=Refusal.FOREIGN
        )
    magic, version, header_size = _PREFIX.unpack_from(data)
    if magic != MAGIC:
        raise MessageError(
            f"message starts with {magic!r}, not {MAGIC!r}: the sender is not Tuberline", reason=Refusal.FOREIGN
        )
    if version != SCHEMA_VERSION:
        raise MessageError(
            f"message has schema version {version}, this node speaks version {SCHEMA_VERSION}: "
            "run the same Tuberline release on every machine of the line",
            reason=Refusal.VERSION,
        )
    if header_size > MAX_HEADER_BYTES or _PREFIX.size + header_size > len(data):
        raise MessageError(
            f"header of {header_size} bytes exceeds the message of {len(data)} bytes or the limit of "
            f"{MAX_HEADER_BYTES}",
            reason=Refusal.SIZE,
        )
    end = _PREFIX.size + header_size
    kind, fields, descriptors = _header(data[_PREFIX.size : end])
    return Header(kind, fields, _announced(descriptors, kind=kind, at=end, end=len(data)))


def read_array(data: bytes, array: Announced) -> NDArray[Any]:
    """The array that `array` announces in the message `data`, read-only.

    Raises:
        MessageError: its bytes are not what they were said to be.
    """
    chunk: bytes | memoryview = memoryview(data)[array.at : array.at + array.size]
    if array.codec == "zstd":
        chunk = _decompress(bytes(chunk), name=array.name, expected=array.bytes)
    dtype = np.dtype(DTYPES[array.dtype]).newbyteorder("<")
    return np.frombuffer(chunk, dtype=dtype).reshape(array.shape)


def shown(value: object) -> str:
    """A value from outside for an error's text, cut short."""
    return _SHOWN.repr(value)


def _header(data: bytes) -> tuple[str, dict[str, Any], list[Any]]:
    try:
        header = msgpack.unpackb(
            data, max_str_len=MAX_TEXT_BYTES, max_array_len=MAX_ITEMS, max_map_len=MAX_ITEMS, max_bin_len=0
        )
    except (ValueError, OverflowError, msgpack.UnpackException, RecursionError) as error:
        raise MessageError(f"header is not MessagePack: {shown(str(error))}", reason=Refusal.HEADER) from error
    if not isinstance(header, dict) or set(header) != {"kind", "fields", "arrays"}:
        raise MessageError(
            f"header is {shown(header)}, not a map of 'kind', 'fields' and 'arrays'", reason=Refusal.HEADER
        )
    kind, fields, arrays = header["kind"], header["fields"], header["arrays"]
    if not (isinstance(kind, str) and isinstance(fields, dict) and isinstance(arrays, list)):
        raise MessageError(
            "header does not have a text for 'kind', a map for 'fields' and a list for 'arrays'", reason=Refusal.HEADER
        )
    if not all(isinstance(field, str) for field in fields):
        raise MessageError(f"header of kind {shown(kind)} has a field name that is not text", reason=Refusal.HEADER)
    _check_values(header)
    return kind, fields, arrays


def _check_values(header: dict[str, Any]) -> None:
    """Refuse what no field may hold: numbers beyond int64, floats that are not finite, values nested too deep."""
    level: list[Any] = [header]
    items = 0
    for _ in range(MAX_NESTING):
        deeper: list[Any] = []
        for container in level:
            items += len(container)
            if items > MAX_ITEMS:
                raise MessageError(f"header has more than {MAX_ITEMS} values", reason=Refusal.SIZE)
            for value in container.values() if isinstance(container, dict) else container:
                if isinstance(value, dict | list):
                    deeper.append(value)
                elif isinstance(value, float):
                    if not math.isfinite(value):
                        raise MessageError(f"header holds the number {value}, not a finite one", reason=Refusal.RANGE)
                elif isinstance(value, int):
                    if value > INT64_MAX:  # MessagePack has none below int64
                        raise MessageError(f"header holds the number {value}, beyond 64 bits", reason=Refusal.RANGE)
                elif not (value is None or isinstance(value, str)):
                    raise MessageError(f"header holds {shown(value)}, which no field is", reason=Refusal.FIELD)
        if not deeper:
            return
        level = deeper
    raise MessageError(f"header has more than {MAX_NESTING} maps and lists within each other", reason=Refusal.SIZE)


def _announced(descriptors: list[Any], *, kind: str, at: int, end: int) -> tuple[Announced, ...]:
    if len(descriptors) > MAX_ARRAYS:
        raise MessageError(
            f"message of kind {shown(kind)} announces {len(descriptors)} arrays; allowed are {MAX_ARRAYS}",
            reason=Refusal.SIZE,
        )
    arrays: list[Announced] = []
    for descriptor in descriptors:
        arrays.append(_one_announced(descriptor, at=at, end=end))
        at += arrays[-1].size
    if len({array.name for array in arrays}) < len(arrays):
        raise MessageError(f"message of kind {shown(kind)} announces an array twice", reason=Refusal.ARRAY)
    together = sum(array.bytes for array in arrays)
    if together > MAX_ARRAY_BYTES:
        raise MessageError(
            f"arrays of {together} bytes together exceed the limit of {MAX_ARRAY_BYTES}", reason=Refusal.SIZE
        )
    if at != end:
        raise MessageError(
            f"message of kind {shown(kind)} has {end - at} bytes after its last array", reason=Refusal.ARRAY
        )
    return tuple(arrays)


def _one_announced(descriptor: Any, *, at: int, end: int) -> Announced:
    if not isinstance(descriptor, dict) or set(descriptor) != {"name", "dtype", "shape", "codec", "size"}:
        raise MessageError(
            f"array descriptor {shown(descriptor)} is not usable: it takes name, dtype, shape, codec and size",
            reason=Refusal.ARRAY,
        )
    name, dtype, shape, codec, size = (descriptor[key] for key in ("name", "dtype", "shape", "codec", "size"))
    where = f"array {shown(name)}"
    if not isinstance(name, str):
        raise MessageError(f"{where} has a name that is not text", reason=Refusal.ARRAY)
    if not isinstance(dtype, str) or dtype not in DTYPES:
        raise MessageError(f"{where} has dtype {shown(dtype)}; allowed: {', '.join(DTYPES)}", reason=Refusal.ARRAY)
    if not isinstance(codec, str) or codec not in ("raw", "zstd"):
        raise MessageError(f"{where} has codec {shown(codec)}; allowed: raw, zstd", reason=Refusal.ARRAY)
    if not isinstance(shape, list) or len(shape) > MAX_DIMENSIONS or not all(_is_size(n) for n in shape):
        raise MessageError(
            f"{where} has shape {shown(shape)}; allowed are up to {MAX_DIMENSIONS} sizes of 0 to {MAX_ARRAY_BYTES}",
            reason=Refusal.ARRAY,
        )
    # As if no side were 0: numpy multiplies the others too, and in 64 bits.
    claimed = math.prod(max(n, 1) for n in shape) * np.dtype(DTYPES[dtype]).itemsize
    if claimed > MAX_ARRAY_BYTES:
        raise MessageError(
            f"{where} of shape {shape}, {claimed} bytes, exceeds the limit of {MAX_ARRAY_BYTES}", reason=Refusal.SIZE
        )
    if not _is_size(size) or at + size > end:
        raise MessageError(
            f"{where} announces {shown(size)} bytes, the message has {end - at} left: it is truncated",
            reason=Refusal.ARRAY,
        )
    array = Announced(name, dtype, tuple(shape), codec, at, size)
    if codec == "raw" and size != array.bytes:
        raise MessageError(f"{where} of shape {shape} needs {array.bytes} bytes, got {size}", reason=Refusal.ARRAY)
    return array


def _is_size(value: object) -> bool:
    return type(value) is int and 0 <= value <= MAX_ARRAY_BYTES


def _decompress(chunk: bytes, *, name: str, expected: int) -> bytes:
    try:
        announced = zstandard.frame_content_size(chunk)
        if announced != expected:
            raise MessageError(
                f"array {shown(name)} decompresses to {announced} bytes, its shape needs {expected}",
                reason=Refusal.ARRAY,
            )
        found = zstandard.ZstdDecompressor().decompress(chunk, max_output_size=expected, allow_extra_data=False)
    except zstandard.ZstdError as error:
        raise MessageError(f"array {shown(name)} is not valid zstd data: {error}", reason=Refusal.ARRAY) from error
    if len(found) != expected:
        raise MessageError(
            f"array {shown(name)} decompressed to {len(found)} bytes, its shape needs {expected}", reason=Refusal.ARRAY
        )
    return found
