"""Frames of one camera of a plain folder recording, read for evaluation and for looking at results.

The running line gets its frames from a camera process; this reader is for the commands that work on a folder without
one.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError
from conveyor.geometry import Intrinsics
from conveyor.messages import Frame


def camera_folders(recording: Path) -> list[Path]:
    """The camera folders of a recording, by name.

    Raises:
        InputError: there are none.
    """
    folders = sorted(path.parent for path in recording.glob("*/camera.json"))
    if not folders and (recording / "camera.json").is_file():
        return [recording]
    if not folders:
        raise InputError(f"{recording} is no folder recording: it has no <camera>/camera.json")
    return folders


def folder_frames(folder: Path, *, masks: bool = False, run: str = "evaluation") -> Iterator[Frame]:
    """The frames of one camera folder in their order; `masks`: with their labels as `Frame.mask` where there are any.

    Raises:
        InputError: a file is missing, broken, or lacks a value.
    """
    camera = _camera(folder)
    k = _intrinsics(camera, folder)
    pose = camera.get("belt_from_camera")
    for row in _rows(folder):
        seq = int(row["seq"])
        mask_path = folder / "mask" / f"{seq:06d}.png"
        yield Frame(
            camera=str(camera.get("name", folder.name)),
            run=run,
            seq=seq,
            captured_ns=int(row["captured_ns"]),
            travel_m=float(row["travel_m"]) if row.get("travel_m") else None,
            depth_scale_m=float(camera["depth_scale_m"]),
            intrinsics=k,
            belt_distance_m=camera.get("belt_distance_m"),
            depth=read_png16(folder / "depth" / f"{seq:06d}.png"),
            belt_from_camera=None if pose is None else np.array(pose, np.float64).reshape(4, 4),
            mask=read_png16(mask_path) if masks and mask_path.is_file() else None,
        )


def read_png16(path: Path) -> NDArray[np.uint16]:
    """(H, W) uint16 of a 16-bit PNG.

    Raises:
        InputError: missing, not an image, or of another kind.
    """
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise InputError(f"{path} cannot be read as an image: it is missing or damaged")
    if image.dtype != np.uint16 or image.ndim != 2:
        raise InputError(f"{path} is {image.dtype} {image.shape}; a 16-bit image with one channel is needed")
    return np.asarray(image, np.uint16)


def _camera(folder: Path) -> dict[str, Any]:
    path = folder / "camera.json"
    try:
        camera = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read: {error}") from error
    if not isinstance(camera, dict):
        raise InputError(f"{path} is a {type(camera).__name__}, not a JSON object")
    return camera


def _intrinsics(camera: dict[str, Any], folder: Path) -> Intrinsics:
    needed = ("width", "height", "fx", "fy", "cx", "cy", "depth_scale_m")
    missing = [key for key in needed if not isinstance(camera.get(key), int | float)]
    if missing:
        raise InputError(f"{folder / 'camera.json'} lacks {', '.join(missing)} (numbers)")
    return Intrinsics(int(camera["width"]), int(camera["height"]), *(float(camera[key]) for key in needed[2:6]))


def _rows(folder: Path) -> list[dict[str, str]]:
    path = folder / "frames.csv"
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path} cannot be read: {error}") from error
    if not rows or not {"seq", "captured_ns"} <= set(rows[0]):
        raise InputError(f"{path} must have the columns seq, captured_ns, travel_m and at least one row")
    return rows
