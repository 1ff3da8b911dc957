"""Clouds from files: .ply, .npy, .npz, .pcd, .xyz, .las, .laz. Camera frame, metres."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.npyio import NpzFile
from numpy.typing import NDArray

from conveyor.errors import InputError
from conveyor.extras import needed
from conveyor.formats.cloud_shape import cloud_fault
from conveyor.formats.numpy_files import numpy_fault
from conveyor.formats.ply import MAX_POINTS, read_ply

Points = NDArray[np.float64]
TEXTS = (".txt", ".csv", ".tsv", ".asc", ".dat", ".pts", ".xyzn", ".xyzrgb")
"""Endings of text that often holds points; not read, for it may hold anything else."""
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
        raise InputError(f"cloud {path} has the ending '{suffix}'; {ending_said([suffix])}")
    points = reader(path)
    if not np.isfinite(points).all():
        bad = int((~np.isfinite(points)).any(1).sum())
        raise InputError(f"cloud {path} has {bad} of {len(points)} points that are not finite: remove them first")
    if len(points) and float(np.abs(points).max()) > 100.0:
        raise InputError(
            f"cloud {path} reaches {float(np.abs(points).max()):.0f} m: it must be in metres (is it in millimetres?)"
        )
    return points


def ending_said(endings: Iterable[str]) -> str:
    """Which endings the names of clouds have, and what to do with files of such `endings`."""
    known = f"clouds end in {', '.join(CLOUDS)}, or in .png, of a depth/rgb pair"
    if any(ending.lower() in TEXTS for ending in endings):
        return f"{known}. Lines of x, y, z in metres are read from a file whose name ends in .xyz: rename it"
    return f"{known}. Save the points, (N, 3) in metres, as .ply or, with np.save, as .npy"


def _read_numpy(path: Path) -> Points:
    try:
        loaded = np.load(path, allow_pickle=False)
        if isinstance(loaded, NpzFile):  # by what it is, not by what it is called
            with loaded as file:
                fitting = [key for key in file.files if file[key].ndim == 2 and file[key].shape[1] == 3]
                if len(fitting) != 1 and "points" not in fitting:
                    raise InputError(f"cloud {path} {_no_one_cloud(file, fitting)}")
                loaded = file["points" if "points" in fitting else fitting[0]]
    except InputError:
        raise
    except Exception as error:  # NumPy lets errors of zip, zlib, tokenizer and memory through for broken files
        fault = numpy_fault(path, error, otherwise="lines of x, y, z are read from a file whose name ends in .xyz")
        raise InputError(f"cloud {path} is not a NumPy file: {fault}") from error
    if fault := cloud_fault(loaded):
        raise InputError(f"cloud {path} must hold x, y, z of each point, (N, 3); it holds {fault}, and save it again")
    return np.asarray(loaded, np.float64)


def _no_one_cloud(file: NpzFile, fitting: list[str]) -> str:
    """What is wrong with an archive of several arrays, of which none is called points, or of none of shape (N, 3)."""
    there = ", ".join(f"{key} {file[key].shape}" for key in file.files) or "none"
    needed_one = f"needs one array of shape (N, 3), or one of that shape named 'points'; it has {there}"
    if fitting:
        return f"{needed_one}: save the one that is meant as 'points'"
    meant = "points" if "points" in file.files else file.files[0] if len(file.files) == 1 else None
    return needed_one if meant is None else f"{needed_one}. '{meant}' is {cloud_fault(file[meant])}, and save it again"


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
