"""The 3DPotatoTwin layout: where its files lie, and its two tables.

`1_rgbd/0_camera_intrinsics/*.json`, `1_rgbd/1_image/<label>/<label>_rgb_<row>.png` beside `<label>_depth_<row>.png`,
`1_rgbd/2_pcd/<label>/<label>_pcd_<row>.ply`, `ground_truth.csv` and `splits.csv`. The number at a name's end is the
tuber's image row. A column `belt_distance_m` of ground_truth.csv says where the camera hung; without it the season
does.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from conveyor.errors import InputError

BELT_DISTANCES_M = {"2023": 0.345, "2024": 0.460, "2025": 0.465}
"""Camera to belt by growing season, H_cam of the paper."""
RGBD = "1_rgbd"
INTRINSICS, IMAGES, CLOUDS = "0_camera_intrinsics", "1_image", "2_pcd"
TRUTH, SPLITS = "ground_truth.csv", "splits.csv"
WEIGHT = "weight_g_inctack"
UNKNOWN = "unknown"
FARTHEST_BELT_M = 10.0
_DEPTH_NAME = re.compile(r"(?P<label>.+)_depth_(?P<row>\d+)\.png")
_CLOUD_NAME = re.compile(r"(?P<label>.+)_pcd_(?P<row>\d+)\.ply")
_PAIR_NAME = re.compile(r"(?P<stem>.+)_(?P<kind>rgb|rgba|depth|depth_z16_mm)(?P<row>_\d+)?\.png")


@dataclass(frozen=True, slots=True)
class TruthRow:
    """One tuber of ground_truth.csv.

    Attributes:
        belt_distance_m: of its own column, else of its season; None where neither is known.
        weight_g, volume_ml, length_mm: None where the table does not say.
    """

    label: str
    season: str
    belt_distance_m: float | None
    cultivar: str = UNKNOWN
    weight_g: float | None = None
    volume_ml: float | None = None
    length_mm: float | None = None


@dataclass(frozen=True, slots=True)
class ViewFile:
    """A depth image or a cloud of one tuber, and the image row in its name."""

    path: Path
    label: str
    row: int


def is_potatotwin(folder: Path) -> bool:
    """The folder is laid out as the data set is; it may hold clouds only."""
    return (folder / RGBD).is_dir()


def has_images(folder: Path) -> bool:
    """The folder has the data set's images, so it is a recording too."""
    return (folder / RGBD / IMAGES).is_dir()


def image_labels(folder: Path) -> list[str]:
    """Labels that have depth images, sorted; an empty folder is left of a label that was not downloaded."""
    images = folder / RGBD / IMAGES
    labels = sorted(path.name for path in images.iterdir() if path.is_dir()) if images.is_dir() else []
    return [label for label in labels if depth_files(folder, label)]


def depth_files(folder: Path, label: str) -> list[ViewFile]:
    """Depth images of a label, by image row."""
    return _view_files(folder / RGBD / IMAGES / label, _DEPTH_NAME)


def cloud_files(folder: Path, label: str) -> list[ViewFile]:
    """Clouds of a label, by image row."""
    return _view_files(folder / RGBD / CLOUDS / label, _CLOUD_NAME)


def _view_files(folder: Path, name: re.Pattern[str]) -> list[ViewFile]:
    paths = folder.iterdir() if folder.is_dir() else ()
    matches = ((path, name.fullmatch(path.name)) for path in paths)
    found = [ViewFile(path, match["label"], int(match["row"])) for path, match in matches if match]
    return sorted(found, key=lambda view: (view.row, view.path.name))


def pair_of(path: Path) -> tuple[Path, Path]:
    """(depth image, mask image) of a pair, given either of them.

    Raises:
        InputError: not such a name, or its partner is missing.
    """
    match = _PAIR_NAME.fullmatch(path.name)
    if match is None:
        raise InputError(f"{path}: a PNG must be named <label>_depth_<row>.png or <label>_rgb_<row>.png")
    row = match["row"] or ""
    depth = [path.with_name(f"{match['stem']}_{kind}{row}.png") for kind in ("depth", "depth_z16_mm")]
    mask = [path.with_name(f"{match['stem']}_{kind}{row}.png") for kind in ("rgb", "rgba")]
    found = [next((file for file in files if file.is_file()), None) for files in (depth, mask)]
    if found[0] is None or found[1] is None:
        lacking = depth if found[0] is None else mask
        raise InputError(f"{path}: its partner {' or '.join(file.name for file in lacking)} is not beside it")
    return found[0], found[1]


def read_truth(folder: Path) -> dict[str, TruthRow]:
    """ground_truth.csv by label; empty where there is no such file.

    Raises:
        InputError: not a table with a column label, two different rows of one label, or a belt distance that is none.
    """
    path = folder / TRUTH
    found: dict[str, TruthRow] = {}
    for number, row in enumerate(_rows(path) if path.is_file() else (), start=2):
        truth = _truth_row(row, f"{path} line {number}")
        if found.setdefault(truth.label, truth) != truth:
            raise InputError(f"{path} line {number}: label '{truth.label}' stands there before, with other values")
    return found


def weight_said(folder: Path, label: str) -> str:
    """Why ground_truth.csv has no weight of a label that stands there, and what to do: for people.

    Raises:
        InputError: it has no column of weights at all.
    """
    said = next((row[WEIGHT] or "" for row in _rows(folder / TRUTH, WEIGHT) if row["label"].strip() == label), "")
    fix = "write decimals with a point" if "," in said else "take out rows of tubers that were not weighed"
    return f"label '{label}' has {WEIGHT} '{said}', which is no number of grams: {fix}"


def truth_of(truth: dict[str, TruthRow], label: str) -> TruthRow:
    """The row of a label; what its name says where it has none."""
    season = _season("", label)
    return truth.get(label) or TruthRow(label, season, BELT_DISTANCES_M.get(season))


def part_by_label(folder: Path) -> dict[str, str]:
    """The part of each label of splits.csv.

    Raises:
        InputError: no such file, or a label that stands in two parts.
    """
    parts: dict[str, str] = {}
    for number, row in enumerate(_rows(folder / SPLITS, "split"), start=2):
        label, part = ((row.get(key) or "").strip() for key in ("label", "split"))
        if parts.setdefault(label, part) != part:
            raise InputError(
                f"{folder / SPLITS} line {number}: label '{label}' is in '{part}' and in '{parts[label]}' before; a "
                "tuber belongs to one part, else it is trained on and tested"
            )
    return parts


def labels_of_split(folder: Path, split: str) -> set[str]:
    """The labels of one split of splits.csv.

    Raises:
        InputError: as `part_by_label`, or no such split (names those there are).
    """
    parts = part_by_label(folder)
    if split not in parts.values():
        known = ", ".join(sorted(set(parts.values()))) or "none: it has no rows"
        raise InputError(f"{folder / SPLITS} has no split '{split}'; known: {known}")
    return {label for label, part in parts.items() if part == split}


def season_at(distance_m: float) -> str | None:
    """The season whose camera hung `distance_m` above the belt."""
    return next((season for season, d in BELT_DISTANCES_M.items() if abs(d - distance_m) < 1e-6), None)


def _truth_row(row: dict[str, str], where: str) -> TruthRow:
    label = (row.get("label") or "").strip()
    season = _season((row.get("growing_season") or "").strip(), label)
    return TruthRow(
        label=label,
        season=season,
        belt_distance_m=_belt_distance_m(row.get("belt_distance_m") or "", where) or BELT_DISTANCES_M.get(season),
        cultivar=(row.get("cultivar") or "").strip() or UNKNOWN,
        weight_g=_measured(row.get(WEIGHT)),
        volume_ml=_measured(row.get("volume_metashape")),
        length_mm=_measured(row.get("x1_length_mm")),
    )


def _season(said: str, label: str) -> str:
    """The table's word, as a year where a program wrote it as 2025.0; else the year that a label begins with
    ('2025-000').
    """
    return said.removesuffix(".0") or (label[:4] if label[:4].isdigit() and len(label) > 4 else UNKNOWN)


def _belt_distance_m(text: str, where: str) -> float | None:
    if not text.strip():
        return None
    try:
        distance_m = float(text)
    except ValueError:
        distance_m = math.nan
    if not 0 < distance_m <= FARTHEST_BELT_M:
        raise InputError(f"{where}: belt_distance_m is '{text}'; allowed are metres, above 0 up to {FARTHEST_BELT_M:g}")
    return distance_m


def _measured(text: str | None) -> float | None:
    """What is empty or no number ('NA') was not measured."""
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _rows(path: Path, *needed: str) -> Iterator[dict[str, str]]:
    """Rows of a table with the column label and all that are `needed`."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = table_reader(file)
            has = reader.fieldnames or ()
            if missing := [name for name in ("label", *needed) if name not in has]:
                raise InputError(
                    f"table {path} has no column '{missing[0]}'; it has {', '.join(has) or 'nothing'}{_separated(has)}"
                )
            yield from reader
    except OSError as error:
        raise InputError(f"table {path} cannot be read: {error.strerror or error}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"table {path} is not CSV text: {error}; save it as CSV in UTF-8") from error


def table_reader(file: TextIO) -> csv.DictReader[str]:
    """Rows by the names of their columns in small letters, without the blanks that some write after each comma.

    Raises:
        csv.Error: as `csv.reader`.
    """
    reader = csv.DictReader(file)
    reader.fieldnames = [name.strip().lower() for name in reader.fieldnames or ()]
    return reader


def _separated(columns: Sequence[str]) -> str:
    """What to do about a table whose one column is all of them."""
    other = next((mark for mark in (";", "\t") if len(columns) == 1 and mark in columns[0]), None)
    words = {";": "semicolons", "\t": "tabs"}
    return f": its columns are separated by {words[other]}; save it with commas, and points in numbers" if other else ""
