"""Clouds from files: .ply, .npy, .npz, .pcd, .xyz, .las, .laz. Camera frame, metres."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError
from conveyor.extras import needed
from conveyor.formats.numpy_files import numpy_fault
from conveyor.formats.ply import MAX_POINTS, read_ply

Points = NDArray[np.float64]
DECIMAL_COMMAS = re.compile(r"(?=.*,)\s*(?:[+-]?\d+(?:,\d+)?(?:[eE][+-]?\d+)?(?:\s+|$)){3}")
"""A line of three numbers, one with a comma at least, that blanks part."""


def read_cloud(path: Path) -> Points:
    """(N, 3) float64 points of a file that `CLOUDS` names by its ending.

    Raises:
        InputError: missing, truncated, of another layout, or not finite; or a package that is not installed.
    """
    suffix = path.suffix.lower()
    if not path.is_file():
        raise InputError(f"cloud {path} {'is a folder' if path.is_dir() else 'does not exist'}")
    reader = CLOUDS.get(suffix)
    if reader is None:
        known = ", ".join(CLOUDS)
        raise InputError(f"cloud {path} has the ending '{suffix}'; known: {known}, or a depth/rgb pair of .png")
    points = reader(path)
    if not np.isfinite(points).all():
        bad = int((~np.isfinite(points)).any(1).sum())
        raise InputError(f"cloud {path} has {bad} of {len(points)} points that are not finite: remove them first")
    if len(points) and float(np.abs(points).max()) > 100.0:
        raise InputError(
            f"cloud {path} reaches {float(np.abs(points).max()):.0f} m: it must be in metres (is it in millimetres?)"
        )
    return points


def _read_numpy(path: Path) -> Points:
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
        fault = numpy_fault(path, error, otherwise="lines of x, y, z are read from a file whose name ends in .xyz")
        raise InputError(f"cloud {path} is not a NumPy file: {fault}") from error
    if loaded.ndim != 2 or loaded.shape[1] != 3 or loaded.dtype.kind not in "fiu":
        raise InputError(f"cloud {path} holds {loaded.dtype} {loaded.shape}; expected numbers of shape (N, 3)")
    return np.asarray(loaded, np.float64)


def _read_xyz(path: Path) -> Points:
    """Lines of x y z and whatever follows, parted by blanks, commas or semicolons; "#" and "//" begin remarks. Commas
    are decimal ones where blanks or semicolons part the first line.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cloud {path} is no text of points: {error}") from error
    lines = text.replace(";", " ").replace("//", "#").splitlines()
    if lines and not any(character.isdigit() for character in lines[0]):
        lines = lines[1:]  # names of columns
    first = next((line for line in lines if line.partition("#")[0].strip()), "")
    comma = "." if DECIMAL_COMMAS.match(first) else " "
    lines = [line.replace(",", comma) for line in lines]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a file without lines; it has no points
        try:
            points = np.loadtxt(lines, np.float64, usecols=(0, 1, 2), ndmin=2)
        except ValueError as error:
            raise InputError(f"cloud {path} has a line that does not begin with x, y, z: {error}") from error
    return points.reshape(-1, 3)


def _read_pcd(path: Path) -> Points:
    """Points that PCL marks as missing (not a number) are left out."""
    library = needed("pypcd4", extra="clouds", what=f"cloud {path.name}")
    try:
        cloud = library.PointCloud.from_path(path)
        points = np.asarray(cloud.numpy(("x", "y", "z")), np.float64)
        announced = int(cloud.metadata.points)
    except Exception as error:  # the library lets errors of pydantic, NumPy and lzf through for broken files
        raise InputError(f"cloud {path} is no whole PCD file with x, y, z: {_first_line(error)}") from error
    if announced != len(points):
        raise InputError(f"cloud {path} is truncated: {announced} points announced, {len(points)} there")
    return points[np.isfinite(points).all(1)]


def _read_las(path: Path) -> Points:
    library = needed("laspy", extra="clouds", what=f"cloud {path.name}")
    try:
        with library.open(path) as file:
            announced = int(file.header.point_count)
            if announced > MAX_POINTS:
                raise InputError(f"cloud {path} announces {announced} points; allowed are up to {MAX_POINTS}")
            cloud = file.read()
            points = np.stack([np.asarray(getattr(cloud, axis), np.float64) for axis in "xyz"], axis=1)
    except InputError:
        raise
    except Exception as error:  # the library lets errors of struct, NumPy and its decoders through for broken files
        raise InputError(f"cloud {path} is no whole LAS file: {_first_line(error)}") from error
    if announced != len(points):
        raise InputError(f"cloud {path} is truncated: {announced} points announced, {len(points)} there")
    return points


CLOUDS: dict[str, Callable[[Path], Points]] = {
    ".ply": read_ply,
    ".npy": _read_numpy,
    ".npz": _read_numpy,
    ".pcd": _read_pcd,
    ".xyz": _read_xyz,
    ".las": _read_las,
    ".laz": _read_las,
}
"""Readers of clouds by the endings of their names."""


def _first_line(error: Any) -> str:
    """What an error says, as far as it fits a sentence."""
    return next(iter(str(error).splitlines()), "") or type(error).__name__
