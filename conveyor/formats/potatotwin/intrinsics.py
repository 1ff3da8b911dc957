"""Intrinsics files: Open3D's camera_intrinsic JSON, as 3DPotatoTwin has them, and the camera.json of a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from conveyor.errors import InputError
from conveyor.formats.plain.pinhole import read_pinhole
from conveyor.formats.potatotwin.layout import INTRINSICS, RGBD
from conveyor.geometry import Intrinsics
from conveyor.text_files import read_json

FOLDERS_ABOVE = 4
"""An image lies three folders below the one that holds `0_camera_intrinsics`, at most."""


def folder_intrinsics(folder: Path) -> tuple[Intrinsics, float]:
    """(intrinsics, metres per depth unit) of a 3DPotatoTwin folder.

    Raises:
        InputError: it has no such file, or one that cannot be used.
    """
    where = folder / RGBD / INTRINSICS
    found = _with_matrix(where)
    if found is None:
        raise InputError(f"{where} holds no JSON file with an intrinsic_matrix; copy it from the data set")
    return read_intrinsics(found)


def find_intrinsics(path: Path) -> Path:
    """The intrinsics file that belongs to an image of a 3DPotatoTwin folder.

    Raises:
        InputError: none in a `0_camera_intrinsics` folder above the image, nor beside or above it.
    """
    looked = []
    for parent in list(path.resolve().parents)[:FOLDERS_ABOVE]:
        looked += [parent / INTRINSICS, parent]
        found = _with_matrix(parent / INTRINSICS) or next(iter(sorted(parent.glob("*intrinsic*.json"))), None)
        if found is not None:
            return found
    raise InputError(
        f"{path}: no *intrinsic*.json found in {', '.join(str(folder) for folder in looked[:3])}, ...; "
        "name it with --intrinsics"
    )


def read_intrinsics(path: Path) -> tuple[Intrinsics, float]:
    """(intrinsics, metres per depth unit) of any file that `read_pinhole` takes and that states the image's size.

    Raises:
        InputError: unreadable, or without width, height and matrix (or fx, fy, cx, cy).
    """
    found = read_pinhole(path)
    if found.width is None or found.height is None:
        raise InputError(f"intrinsics {path} do not say the image's size: add width and height, pixels")
    return found.intrinsics(found.width, found.height, where=path), found.depth_scale_m or 0.001


def intrinsics_json(k: Intrinsics) -> dict[str, Any]:
    """Open3D's layout: the matrix column by column, `depth_scale` in units per metre (1 mm)."""
    matrix = [k.fx, 0.0, 0.0, 0.0, k.fy, 0.0, k.cx, k.cy, 1.0]
    return {"width": k.width, "height": k.height, "depth_scale": 1000.0, "intrinsic_matrix": matrix}


def _with_matrix(folder: Path) -> Path | None:
    """The first JSON file that has a matrix: the data set's folder holds the camera's settings too."""
    for file in sorted(folder.glob("*.json")):
        raw = read_json(file, what="intrinsics")
        if isinstance(raw, dict) and "intrinsic_matrix" in raw:
            return file
    return None
