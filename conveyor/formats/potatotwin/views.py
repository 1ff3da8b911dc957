"""The tubers of a 3DPotatoTwin folder as labelled views: what training and studies read."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError
from conveyor.formats.ply import read_ply
from conveyor.formats.potatotwin.intrinsics import folder_intrinsics
from conveyor.formats.potatotwin.layout import (
    BELT_DISTANCES_M,
    CLOUDS,
    IMAGES,
    INTRINSICS,
    RGBD,
    SPLITS,
    TRUTH,
    TruthRow,
    ViewFile,
    cloud_files,
    depth_files,
    labels_of_split,
    part_by_label,
    read_truth,
    weight_said,
)
from conveyor.formats.potatotwin.pairs import NoDepthError, farthest_m, read_pair
from conveyor.geometry import Intrinsics

IMAGE_ROWS = 720
"""Of the data set's camera, where clouds come without intrinsics."""


@dataclass(frozen=True, slots=True)
class TwinView:
    """One frame of one tuber: a depth crop with its intrinsics (principal point of the crop), or a cloud, which is
    empty where a pair of images shows no depth of its tuber.

    `name` is the file's. `volume_ml` and `length_mm` are NaN where the table does not say; `row_share` is the tuber's
    image row by all rows.
    """

    label: str
    name: str
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


def read_twin(folder: Path, *, split: str | None = None) -> Iterator[TwinView]:
    """Frames of all tubers in the order of ground_truth.csv, by row; clouds of those that have no images.

    Raises:
        InputError: missing or broken table, intrinsics or image; a tuber without a weight or a belt distance.
    """
    if not (folder / TRUTH).is_file():
        raise InputError(f"table {folder / TRUTH} does not exist: without it no weight is known")
    chosen = labels_of_split(folder, split) if split else None
    has_camera = (folder / RGBD / INTRINSICS).is_dir()
    camera: tuple[Intrinsics, float] | None = folder_intrinsics(folder) if has_camera else None
    for label, truth in read_truth(folder).items():
        if chosen is None or label in chosen:
            for view in depth_files(folder, label) or cloud_files(folder, label):
                yield _view(folder, view, truth, camera)


def count_twin(folder: Path, *, split: str | None = None) -> int:
    """How many views `read_twin` would read."""
    chosen = labels_of_split(folder, split) if split else None
    labels = [label for label in read_truth(folder) if chosen is None or label in chosen]
    return sum(len(depth_files(folder, label) or cloud_files(folder, label)) for label in labels)


def labels_without_views(folder: Path, *, split: str | None = None) -> list[str]:
    """Labels of the table, or of one part of splits.csv, of which there is no view with a weight.

    Raises:
        InputError: none has any; names what stands in the tables and the folders.
    """
    truth = read_truth(folder)
    labels = sorted(labels_of_split(folder, split)) if split else list(truth)
    without = [
        label
        for label in labels
        if label not in truth or not (depth_files(folder, label) or cloud_files(folder, label))
    ]
    if without == labels:
        here = [path.name for name in (IMAGES, CLOUDS) for path in sorted((folder / RGBD / name).glob("*"))]
        part = f"{_some(labels)} in '{split}' of {SPLITS}, " if split else ""
        raise InputError(
            f"{folder}: no label has both a row in {TRUTH} and images ({RGBD}/{IMAGES}/LABEL/LABEL_depth_ROW.png) or "
            f"clouds ({RGBD}/{CLOUDS}/LABEL/LABEL_pcd_ROW.ply): {part}{_some(list(truth))} in {TRUTH}, {_some(here)} "
            "in the folders; a label is written alike in all of them"
        )
    return without


def left_out_told(folder: Path) -> str:
    """For people: what no part of a folder has, and no training or study of a part reads; empty where that is nothing.

    Labels of the table that stand in no part of splits.csv, or have neither depth images nor clouds; labels of
    splits.csv, of images or of clouds that the table lacks; and colour images whose depth image is missing.

    Raises:
        InputError: a table that cannot be read.
    """
    truth = read_truth(folder)
    parts = part_by_label(folder) if (folder / SPLITS).is_file() else dict.fromkeys(truth, "")
    folders = {path.name for name in (IMAGES, CLOUDS) for path in (folder / RGBD / name).glob("*")}
    viewed = {label for label in folders if depth_files(folder, label) or cloud_files(folder, label)}
    unlisted = [label for label in truth if label not in parts]
    unseen = [label for label in truth if label in parts and label not in viewed]
    unweighed = [label for label in parts if label not in truth]
    unnamed = sorted(viewed - truth.keys() - parts.keys()) if truth else []
    colour = sorted((folder / RGBD / IMAGES).glob("*/*_rgb_*.png"))
    alone = [path.name for path in colour if not path.with_name(path.name.replace("_rgb_", "_depth_")).is_file()]
    told = []
    if unlisted:
        told.append(f"{_labels(unlisted, TRUTH)} in no part of {SPLITS} ({_some(unlisted)})")
    if unseen:
        told.append(f"{_labels(unseen, TRUTH)} without depth images and clouds ({_some(unseen)})")
    if unweighed:
        told.append(f"{_labels(unweighed, SPLITS)} without a row in {TRUTH} ({_some(unweighed)})")
    if unnamed:
        told.append(f"{_labels(unnamed, 'images or clouds')} without a row in {TRUTH} ({_some(unnamed)})")
    if unseen or unweighed or unnamed:
        told[-1] += ": a label is written alike in tables and folders"
    if alone:
        told.append(
            f"{len(alone)} colour image{'s' * (len(alone) > 1)} without a depth image of the name ({_some(alone)})"
        )
    return f"{folder}: left out: {'; '.join(told)}" if told else ""


def _labels(names: list[str], where: str) -> str:
    return f"{len(names)} label{'s' * (len(names) > 1)} of {where}"


def _some(names: list[str]) -> str:
    return ", ".join(f"'{name}'" for name in names[:3]) + (", ..." if len(names) > 3 else "") or "nothing"


def _view(folder: Path, view: ViewFile, truth: TruthRow, camera: tuple[Intrinsics, float] | None) -> TwinView:
    belt_distance_m, weight_g = _known(folder, view, truth)
    depth = cloud = crop = None
    scale_m = 0.001
    if view.path.suffix == ".png":
        intrinsics, scale_m = camera or folder_intrinsics(folder)
        far_m = farthest_m(belt_distance_m)
        try:
            masked = read_pair(view.path, intrinsics=intrinsics, max_depth_m=far_m, depth_scale_m=scale_m)
            depth, crop = masked.depth, masked.intrinsics
        except NoDepthError:
            cloud = np.empty((0, 3))
    else:
        cloud = read_ply(view.path)
    return TwinView(
        label=truth.label,
        name=view.path.name,
        depth=depth,
        cloud=cloud,
        depth_scale_m=scale_m,
        intrinsics=crop,
        belt_distance_m=belt_distance_m,
        weight_g=weight_g,
        volume_ml=math.nan if truth.volume_ml is None else truth.volume_ml,
        length_mm=math.nan if truth.length_mm is None else truth.length_mm,
        cultivar=truth.cultivar,
        season=truth.season,
        row_share=view.row / (camera[0].height if camera else IMAGE_ROWS),
    )


def _known(folder: Path, view: ViewFile, truth: TruthRow) -> tuple[float, float]:
    """(belt distance in metres, weight in grams), without which nothing can be learnt from a view."""
    if truth.belt_distance_m is None:
        known = ", ".join(f"{season} ({distance_m:g} m)" for season, distance_m in BELT_DISTANCES_M.items())
        raise InputError(
            f"{view.path}: growing season '{truth.season}' has no known belt distance; known are {known}; "
            f"another one stands in a column belt_distance_m of {TRUTH}"
        )
    if truth.weight_g is None:
        raise InputError(f"{folder / TRUTH}: {weight_said(folder, truth.label)}")
    if truth.weight_g <= 0:
        raise InputError(
            f"{folder / TRUTH}: label '{truth.label}' has weight_g_inctack {truth.weight_g:g}; allowed are grams above "
            "0: take out rows of tubers that were not weighed"
        )
    return truth.belt_distance_m, truth.weight_g
