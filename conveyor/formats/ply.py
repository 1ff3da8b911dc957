"""PLY clouds, ascii and binary of either byte order: the vertices' x, y, z, read with suspicion and written.

Ours rather than a library's. trimesh 5.2 takes an ascii file that is cut short for a whole one, and a header without an
end as an IndexError; meshio 5.3.5 reads such a header without end and makes room for as many vertices as it claims;
plyfile is GPL. None says in words what is wrong, none is faster.
"""

from __future__ import annotations

import codecs
import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError

MAX_POINTS = 20_000_000
MAX_HEADER_LINES = 256
_PLY_TYPES = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}


def read_ply(path: Path) -> NDArray[np.float64]:
    """(N, 3) float64 x, y, z of the vertex element.

    Raises:
        InputError: not a PLY file, no vertices with x, y, z, or truncated.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cloud {path} cannot be read: {error.strerror or error}") from error
    text = data.removeprefix(codecs.BOM_UTF8)
    form, count, names, kinds, body = _ply_header(text, path)
    if form != "ascii" and text != data:
        raise InputError(
            f"cloud {path} is {form} and begins with a byte-order mark: a program took it for text, and its points may "
            "be damaged; export it again"
        )
    data = text
    columns = [names.index(axis) for axis in "xyz" if axis in names]
    if len(columns) != 3:
        raise InputError(f"cloud {path} has no x, y, z; its vertices have {', '.join(names) or 'nothing'}")
    if form == "ascii":
        return _ply_ascii(data[body:], count, columns, path)
    order = _ORDERS[form]
    record = np.dtype([(name, order + kind) for name, kind in zip(names, kinds, strict=True)])
    if len(data) - body < count * record.itemsize:
        raise InputError(
            f"cloud {path} is truncated: {count} vertices need {count * record.itemsize} bytes, {len(data) - body} left"
        )
    vertices = np.frombuffer(data, record, count=count, offset=body)
    return np.stack([vertices[axis].astype(np.float64) for axis in "xyz"], axis=1)


def _ply_header(data: bytes, path: Path) -> tuple[str, int, list[str], list[str], int]:
    """(format, vertices, their property names, their types, offset of the body)."""
    if not data.startswith(b"ply"):
        raise InputError(f"cloud {path} is not a PLY file: it starts with {data[:8]!r}")
    form, element, count = "", "", 0
    names: list[str] = []
    kinds: list[str] = []
    offset = 0
    for _ in range(MAX_HEADER_LINES):
        end = data.find(b"\n", offset)
        if end < 0:
            break
        words = data[offset:end].decode("ascii", "replace").split()
        offset = end + 1
        match words:
            case ["end_header"]:
                if form not in ("ascii", *_ORDERS):
                    raise InputError(f"cloud {path} has PLY format '{form}'; known: ascii, {', '.join(_ORDERS)}")
                if not 0 <= count <= MAX_POINTS:
                    raise InputError(f"cloud {path} announces {count} vertices; allowed are up to {MAX_POINTS}")
                return form, count, names, kinds, offset
            case ["format", name, *_]:
                form = name
            case ["element", name, number] if number.isdigit() and len(number) <= 12:
                if name != "vertex" and not names:
                    raise InputError(f"cloud {path}: the vertex element must come first, found '{name}'")
                element, count = name, int(number) if name == "vertex" else count
            case ["property", kind, name] if element == "vertex" and kind in _PLY_TYPES:
                if name in names:
                    raise InputError(f"cloud {path} names the vertex property '{name}' twice")
                names.append(name)
                kinds.append(_PLY_TYPES[kind])
            case ["property", *rest] if element == "vertex":
                raise InputError(f"cloud {path} has a vertex property that cannot be read: {' '.join(rest)}")
    raise InputError(f"cloud {path} has no end_header in its first {MAX_HEADER_LINES} lines")


def _ply_ascii(body: bytes, count: int, columns: list[int], path: Path) -> NDArray[np.float64]:
    if count == 0:
        return np.empty((0, 3))
    if body.strip() == b"":
        raise InputError(f"cloud {path} is truncated: {count} vertices announced, 0 lines left")
    try:
        points = np.loadtxt(io.BytesIO(body), np.float64, usecols=columns, max_rows=count, ndmin=2, comments=None)
    except (ValueError, IndexError) as error:
        raise InputError(f"cloud {path} has a vertex line that is not numbers: {error}") from error
    if len(points) != count:
        raise InputError(f"cloud {path} is truncated: {count} vertices announced, {len(points)} lines left")
    return np.asarray(points, np.float64)


def write_ply(path: Path, points_m: NDArray[np.floating]) -> None:
    """A binary PLY file of (N, 3) points, metres, as float64 like those of 3DPotatoTwin."""
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points_m)}\n"
    header += "".join(f"property double {axis}\n" for axis in "xyz") + "end_header\n"
    path.write_bytes(header.encode() + points_m.astype("<f8").tobytes())
