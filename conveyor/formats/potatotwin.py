"""Reading a 3DPotatoTwin folder: tuber after tuber, each in the rows it was photographed in.

Layout (FORMATS, section 2): `1_rgbd/1_image/<label>/<label>_rgb_<row>.png` whose alpha is the tuber's mask, and
`<label>_depth_<row>.png` in millimetres. The number at a name's end is the tuber's image row. A season is a camera
here, because the belt distance is one per season.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from conveyor.errors import InputError
from conveyor.formats.png16 import Refusal, read_png16
from conveyor.formats.source import CameraDescription, FrameKey, Refused
from conveyor.geometry import Intrinsics
from conveyor.messages import Frame

BELT_DISTANCES_M = {"2023": 0.345, "2024": 0.460, "2025": 0.465}
FPS = 30.0
MIDDLE_HEIGHT_M = 0.025
"""Height of a tuber's middle, at which its image row becomes belt travel."""
BETWEEN_TUBERS_M = 0.6
EPOCH_NS = 1_694_000_000_000_000_000
_DEPTH_NAME = re.compile(r"(.+)_depth_(\d+)\.png")


@dataclass(frozen=True, slots=True)
class _Picture:
    label: str
    row: int
    depth: Path
    rgb: Path


def is_potatotwin(path: Path) -> bool:
    """The folder has the data set's image folder."""
    return (path / "1_rgbd" / "1_image").is_dir()


def seasons(path: Path) -> tuple[str, ...]:
    """Seasons of the labels that have images; '2023' and so on, or 'unknown' without a ground truth."""
    season_of = _season_of(path)
    images = path / "1_rgbd" / "1_image"
    return tuple(sorted({season_of.get(d.name, "unknown") for d in images.iterdir() if d.is_dir()}))


class PotatoTwinSource:
    """All tubers of one season, label after label, as frames of one camera with given masks and travel."""

    def __init__(self, path: Path, season: str) -> None:
        self._path = path
        self._intrinsics, self._depth_scale_m = _intrinsics(path)
        season_of = _season_of(path)
        images = path / "1_rgbd" / "1_image"
        labels = sorted(d.name for d in images.iterdir() if d.is_dir() and season_of.get(d.name, "unknown") == season)
        self._pictures = [picture for label in labels for picture in _pictures(images / label)]
        if not self._pictures:
            raise InputError(f"{images} holds no <label>/<label>_depth_<row>.png of season {season}")
        self._season = season

    @property
    def description(self) -> CameraDescription:
        """Intrinsics from the data set, belt distance from the season."""
        return CameraDescription(
            name=self._season,
            origin=f"3DPotatoTwin {self._path}, season {self._season}",
            intrinsics=self._intrinsics,
            depth_scale_m=self._depth_scale_m,
            belt_distance_m=BELT_DISTANCES_M.get(self._season),
            belt_from_camera=None,
            fps=FPS,
            frames=len(self._pictures),
        )

    def frames(self, *, run: str, after: int = -1) -> Iterator[Frame | Refused]:
        """Pictures in the order of label and row. Travel follows the rows; between two tubers the belt runs 0.6 m."""
        distance = BELT_DISTANCES_M.get(self._season, 0.4)
        metres_per_row = (distance - MIDDLE_HEIGHT_M) / self._intrinsics.fy
        travel_m, before = 0.0, None
        for seq, picture in enumerate(self._pictures):
            if before is not None:
                same = before.label == picture.label
                travel_m += (picture.row - before.row) * metres_per_row if same else BETWEEN_TUBERS_M
            before = picture
            if seq > after:
                yield self._frame(seq, picture, travel_m, run)

    def keys(self) -> list[FrameKey]:
        """One per picture, at 30 frames/s."""
        return [FrameKey(seq, _captured_ns(seq)) for seq in range(len(self._pictures))]

    def _frame(self, seq: int, picture: _Picture, travel_m: float, run: str) -> Frame | Refused:
        size = (self._intrinsics.height, self._intrinsics.width)
        depth = read_png16(picture.depth)
        if isinstance(depth, Refusal):
            return Refused(seq, depth.reason, f"{picture.depth} {depth.text}")
        rgba = cv2.imread(str(picture.rgb), cv2.IMREAD_UNCHANGED) if picture.rgb.is_file() else None
        if rgba is None or rgba.ndim != 3 or rgba.shape[2] != 4:
            return Refused(seq, "no_mask", f"{picture.rgb} is no RGBA image whose alpha is the tuber's mask")
        if depth.shape != size or rgba.shape[:2] != size:
            return Refused(
                seq,
                "wrong_size",
                f"{picture.depth} is {depth.shape}, its rgb {rgba.shape[:2]}, intrinsics are for {size}",
            )
        jpeg = cv2.imencode(".jpg", rgba[..., :3], [cv2.IMWRITE_JPEG_QUALITY, 90])[1]
        return Frame(
            camera=self._season,
            run=run,
            seq=seq,
            captured_ns=_captured_ns(seq),
            travel_m=travel_m,
            depth_scale_m=self._depth_scale_m,
            intrinsics=self._intrinsics,
            belt_distance_m=BELT_DISTANCES_M.get(self._season),
            depth=depth,
            mask=(rgba[..., 3] > 0).astype(np.uint16),
            color_jpeg=np.asarray(jpeg, np.uint8).ravel(),
        )


def _captured_ns(seq: int) -> int:
    return EPOCH_NS + round(seq * 1e9 / FPS)


def _pictures(folder: Path) -> list[_Picture]:
    found = []
    for path in folder.iterdir():
        match = _DEPTH_NAME.fullmatch(path.name)
        if match:
            label, row = match.groups()
            found.append(_Picture(label, int(row), path, folder / f"{label}_rgb_{row}.png"))
    return sorted(found, key=lambda picture: picture.row)


def _season_of(path: Path) -> dict[str, str]:
    table = path / "ground_truth.csv"
    if not table.is_file():
        return {}
    with table.open(newline="", encoding="utf-8") as file:
        return {
            row["label"]: row["growing_season"].strip() for row in csv.DictReader(file) if row.get("growing_season")
        }


def _intrinsics(path: Path) -> tuple[Intrinsics, float]:
    """(intrinsics, metres per depth unit) from the Open3D JSON whose 3x3 matrix is column-major."""
    folder = path / "1_rgbd" / "0_camera_intrinsics"
    for file in sorted(folder.glob("*.json")):
        raw: Any = json.loads(file.read_text(encoding="utf-8"))
        if not isinstance(raw, dict) or "intrinsic_matrix" not in raw:
            continue
        m = raw["intrinsic_matrix"]
        try:
            k = Intrinsics(int(raw["width"]), int(raw["height"]), float(m[0]), float(m[4]), float(m[6]), float(m[7]))
            return k, round(1.0 / float(raw["depth_scale"]), 7)
        except (KeyError, IndexError, TypeError, ValueError, ZeroDivisionError) as error:
            raise InputError(
                f"{file} cannot be used ({error!r}): needed are width, height, depth_scale and the 9 numbers of "
                "intrinsic_matrix"
            ) from error
    raise InputError(f"{folder} holds no JSON file with an intrinsic_matrix; copy it from the data set")
