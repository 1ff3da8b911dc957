"""Clouds from files: .ply (ascii and binary), .npy, .npz. Camera frame, metres."""

from __future__ import annotations

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


def read_cloud(path: Path) -> NDArray[np.float64]:
    """(N, 3) float64 points of a .ply, .npy or .npz file.

    Raises:
        InputError: missing, truncated, of another layout, or not finite.
    """
    suffix = path.suffix.lower()
    if not path.is_file():
        raise InputError(f"cloud {path} does not exist")
    if suffix == ".ply":
        points = read_ply(path)
    elif suffix in (".npy", ".npz"):
        points = _read_numpy(path)
    else:
        raise InputError(
            f"cloud {path} has the ending '{suffix}'; known: .ply, .npy, .npz, or a depth/rgb pair of .png"
        )
    if not np.isfinite(points).all():
        bad = int((~np.isfinite(points)).any(1).sum())
        raise InputError(f"cloud {path} has {bad} of {len(points)} points that are not finite: remove them first")
    if len(points) and float(np.abs(points).max()) > 100.0:
        raise InputError(
            f"cloud {path} reaches {float(np.abs(points).max()):.0f} m: it must be in metres (is it in millimetres?)"
        )
    return points


def _read_numpy(path: Path) -> NDArray[np.float64]:
    try:
        loaded = np.load(path, allow_pickle=False)
        if isinstance(loaded, np.lib.npyio.NpzFile):  # by what it is, not by what it is called
            with loaded as file:
                fitting = [key for key in file.files if file[key].ndim == 2 and file[key].shape[1] == 3]
                if len(fitting) != 1 and "points" not in fitting:
                    raise InputError(
                        f"cloud {path} needs one array of shape (N, 3) or one named 'points'; it has "
                        + (", ".join(f"{key} {file[key].shape}" for key in file.files) or "none")
                    )
                loaded = file["points" if "points" in fitting else fitting[0]]
    except InputError:
        raise
    except Exception as error:  # NumPy lets errors of zip, zlib, tokenizer and memory through for broken files
        raise InputError(f"cloud {path} is not a NumPy file: {error}") from error
    if loaded.ndim != 2 or loaded.shape[1] != 3 or loaded.dtype.kind not in "fiu":
        raise InputError(f"cloud {path} holds {loaded.dtype} {loaded.shape}; expected numbers of shape (N, 3)")
    return np.asarray(loaded, np.float64)


def read_ply(path: Path) -> NDArray[np.float64]:
    """(N, 3) float64 x, y, z of the vertex element.

    Raises:
        InputError: not a PLY file, no vertices with x, y, z, or truncated.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cloud {path} cannot be read: {error.strerror or error}") from error
    form, count, names, kinds, body = _ply_header(data, path)
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
    lines = body.split(b"\n")[:count]
    try:
        values = [[float(word) for word in line.split()] for line in lines]
        points = np.array([[row[column] for column in columns] for row in values], np.float64).reshape(-1, 3)
    except (ValueError, IndexError) as error:
        raise InputError(f"cloud {path} has a vertex line that is not numbers: {error}") from error
    if len(points) != count:
        raise InputError(f"cloud {path} is truncated: {count} vertices announced, {len(points)} lines left")
    return points
