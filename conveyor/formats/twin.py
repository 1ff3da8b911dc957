"""The 3DPotatoTwin layout (docs/pointraft.md, data): depth and mask images or clouds, with ground_truth.csv.

`1_rgbd/1_image/<label>/<label>_rgb_<row>.png` (RGBA, alpha 255 = the tuber) beside `<label>_depth_<row>.png` (uint16),
`1_rgbd/2_pcd/<label>/<label>_pcd_<row>.ply`, `1_rgbd/0_camera_intrinsics/*.json` (Open3D: 9 numbers, column-major).
A column belt_distance_m of ground_truth.csv says where the camera hung; without it the paper's seasons do.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError
from conveyor.formats.ply import read_ply
from conveyor.geometry import Intrinsics

BELT_DISTANCE_M = {"2023": 0.345, "2024": 0.460, "2025": 0.465}
MAX_DEPTH_M = 0.5
_PAIR = re.compile(r"(?P<stem>.+)_(?P<kind>rgb|rgba|depth|depth_z16_mm)(?P<row>_\d+)?\.png")


@dataclass(frozen=True, slots=True)
class TwinView:
    """One frame of one tuber: a depth crop with its intrinsics (principal point of the crop), or a cloud."""

    label: str
    depth: NDArray[np.uint16] | None
    cloud: NDArray[np.float64] | None
    depth_scale_m: float
    intrinsics: Intrinsics | None
    belt_distance_m: float
    weight_g: float
    volume_ml: float
    length_mm: float
    cultivar: str
    season: str
    row_share: float


@dataclass(frozen=True, slots=True)
class MaskedDepth:
    """A tuber's depth crop. `depth` (h, w) uint16 is zero outside the mask; `intrinsics` are of the crop."""

    depth: NDArray[np.uint16]
    intrinsics: Intrinsics


def is_twin(folder: Path) -> bool:
    """Whether `folder` looks like a 3DPotatoTwin download."""
    return (folder / "1_rgbd").is_dir() and (folder / "ground_truth.csv").is_file()


def read_twin(folder: Path, *, split: str | None = None) -> Iterator[TwinView]:
    """Frames of all tubers with a known weight, sorted by label and row; images first, clouds where there are none.

    Raises:
        InputError: missing or broken table, intrinsics or image.
    """
    chosen = _labels_of_split(folder, split) if split else None
    for row in _rows(folder / "ground_truth.csv"):
        label = row.get("label", "")
        if chosen is not None and label not in chosen:
            continue
        images = sorted((folder / "1_rgbd" / "1_image" / label).glob(f"{label}_depth_*.png"))
        clouds = sorted((folder / "1_rgbd" / "2_pcd" / label).glob(f"{label}_pcd_*.ply"))
        for path in images or clouds:
            yield _view(folder, path, row)


def _view(folder: Path, path: Path, row: dict[str, str]) -> TwinView:
    season = row.get("growing_season") or row.get("label", "")[:4]
    if not row.get("belt_distance_m") and season not in BELT_DISTANCE_M:
        raise InputError(
            f"{path}: growing season '{season}' has no known belt distance; known: {BELT_DISTANCE_M}; another one "
            "stands in a column belt_distance_m of ground_truth.csv"
        )
    depth = cloud = intrinsics = None
    scale = 0.001
    if path.suffix == ".png":
        intrinsics, scale = read_intrinsics(find_intrinsics(path))
        masked = read_pair(path, intrinsics=intrinsics, max_depth_m=MAX_DEPTH_M, depth_scale_m=scale)
        depth, intrinsics = masked.depth, masked.intrinsics
    else:
        cloud = read_ply(path)
    return TwinView(
        label=row["label"],
        depth=depth,
        cloud=cloud,
        depth_scale_m=scale,
        intrinsics=intrinsics,
        belt_distance_m=_number(row, "belt_distance_m", path, default=BELT_DISTANCE_M.get(season)),
        weight_g=_number(row, "weight_g_inctack", path),
        volume_ml=_number(row, "volume_metashape", path, default=float("nan")),
        length_mm=_number(row, "x1_length_mm", path, default=float("nan")),
        cultivar=row.get("cultivar", "unknown"),
        season=season,
        row_share=int(path.stem.rsplit("_", 1)[1]) / 720.0,
    )


def pair_of(path: Path) -> tuple[Path, Path]:
    """(depth image, mask image) of a 3DPotatoTwin pair, given either of them.

    Raises:
        InputError: not such a name, or its partner is missing.
    """
    match = _PAIR.fullmatch(path.name)
    if match is None:
        raise InputError(f"{path}: a PNG must be named <label>_depth_<row>.png or <label>_rgb_<row>.png")
    row = match["row"] or ""
    folder = path.parent
    depth = [folder / f"{match['stem']}_{kind}{row}.png" for kind in ("depth", "depth_z16_mm")]
    mask = [folder / f"{match['stem']}_{kind}{row}.png" for kind in ("rgb", "rgba")]
    found = [next((file for file in files if file.is_file()), None) for files in (depth, mask)]
    if found[0] is None or found[1] is None:
        lacking = depth if found[0] is None else mask
        raise InputError(f"{path}: its partner {' or '.join(file.name for file in lacking)} is not beside it")
    return found[0], found[1]


def read_pair(path: Path, *, intrinsics: Intrinsics, depth_scale_m: float, max_depth_m: float) -> MaskedDepth:
    """The masked depth of a pair, cropped to its mask. As in the reference: alpha exactly 255, 0 < z < `max_depth_m`.

    Raises:
        InputError: unreadable, wrong type, other size, empty mask.
    """
    depth_path, mask_path = pair_of(path)
    image = _read_png(depth_path)
    mask = _read_png(mask_path)
    if image.ndim != 2 or image.dtype != np.uint16:
        raise InputError(f"{depth_path}: expected 16-bit grey, got {image.dtype} {image.shape}")
    depth = image.astype(np.uint16)
    if mask.ndim != 3 or mask.shape[2] != 4:
        raise InputError(f"{mask_path}: expected RGBA with the mask as alpha, got shape {mask.shape}")
    if mask.shape[:2] != depth.shape:
        raise InputError(f"{mask_path} is {mask.shape[:2]}, {depth_path.name} is {depth.shape} (rows, columns)")
    if depth.shape != (intrinsics.height, intrinsics.width):
        raise InputError(
            f"{depth_path} is {depth.shape[1]}x{depth.shape[0]}, the intrinsics are for "
            f"{intrinsics.width}x{intrinsics.height}"
        )
    inside = (mask[:, :, 3] == 255) & (depth > 0) & (depth.astype(np.float64) * depth_scale_m < max_depth_m)
    if not inside.any():
        raise InputError(f"{mask_path}: no pixel has alpha 255 and a depth in 0..{max_depth_m} m")
    rows, columns = np.nonzero(inside.any(1))[0], np.nonzero(inside.any(0))[0]
    box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    crop = np.where(inside, depth, 0)[box].astype(np.uint16)
    shifted = Intrinsics(
        width=crop.shape[1],
        height=crop.shape[0],
        fx=intrinsics.fx,
        fy=intrinsics.fy,
        cx=intrinsics.cx - float(columns[0]),
        cy=intrinsics.cy - float(rows[0]),
    )
    return MaskedDepth(crop, shifted)


def _read_png(path: Path) -> NDArray[np.generic]:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) if path.is_file() else None
    if image is None:
        raise InputError(f"image {path} cannot be read: missing, truncated or not a PNG")
    return image


def find_intrinsics(path: Path) -> Path:
    """The camera_intrinsic JSON that belongs to an image of a 3DPotatoTwin folder.

    Raises:
        InputError: none in a `0_camera_intrinsics` folder above the image, nor beside or above it.
    """
    looked = []
    for parent in list(path.resolve().parents)[:4]:
        for folder in (parent / "0_camera_intrinsics", parent):
            looked.append(folder)
            for file in sorted(folder.glob("*intrinsic*.json")):
                return file
    raise InputError(
        f"{path}: no *intrinsic*.json found in {', '.join(str(folder) for folder in looked[:3])}, ...; "
        "name it with --intrinsics"
    )


def read_intrinsics(path: Path) -> tuple[Intrinsics, float]:
    """(intrinsics, metres per depth unit) of an Open3D camera_intrinsic JSON or of a recording's camera.json.

    Raises:
        InputError: unreadable, or without width, height and matrix (or fx, fy, cx, cy).
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if "intrinsic_matrix" in data:
            matrix = [float(value) for value in data["intrinsic_matrix"]]
            fx, fy, cx, cy = matrix[0], matrix[4], matrix[6], matrix[7]
            scale = 1.0 / round(float(data.get("depth_scale", 1000.0)), 3)
        else:
            fx, fy, cx, cy = (float(data[key]) for key in ("fx", "fy", "cx", "cy"))
            scale = float(data.get("depth_scale_m", 0.001))
        size = int(data["width"]), int(data["height"])
    except (OSError, ValueError, KeyError, TypeError, IndexError, ZeroDivisionError) as error:
        raise InputError(
            f"intrinsics {path} cannot be used ({error!r}): expected width, height and intrinsic_matrix (9 numbers, "
            "column-major) or fx, fy, cx, cy"
        ) from error
    return Intrinsics(width=size[0], height=size[1], fx=fx, fy=fy, cx=cx, cy=cy), scale


def _labels_of_split(folder: Path, split: str) -> set[str]:
    rows = list(_rows(folder / "splits.csv"))
    known = sorted({row.get("split", "") for row in rows})
    if split not in known:
        raise InputError(f"{folder / 'splits.csv'} has no split '{split}'; known: {', '.join(known)}")
    return {row["label"] for row in rows if row.get("split") == split}


def _rows(path: Path) -> Iterator[dict[str, str]]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            yield from csv.DictReader(file)
    except OSError as error:
        raise InputError(f"table {path} cannot be read: {error.strerror or error}") from error


def _number(row: dict[str, str], column: str, where: Path, *, default: float | None = None) -> float:
    text = row.get(column) or ""
    try:
        return float(text)
    except ValueError:
        if default is not None:
            return default
        raise InputError(f"{where}: column '{column}' of ground_truth.csv holds '{text}', not a number") from None
