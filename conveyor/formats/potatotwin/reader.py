"""A 3DPotatoTwin folder as a recording: tuber after tuber, each in the rows it was photographed in.

A camera here is a season, because the belt distance is one per season; where a season's tubers have several distances
(column `belt_distance_m`), one camera per distance.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from conveyor.errors import InputError
from conveyor.formats.png16 import Refusal
from conveyor.formats.potatotwin.intrinsics import folder_intrinsics
from conveyor.formats.potatotwin.layout import (
    IMAGES,
    RGBD,
    UNKNOWN,
    ViewFile,
    depth_files,
    image_labels,
    read_truth,
    truth_of,
)
from conveyor.formats.potatotwin.pairs import read_images
from conveyor.formats.potatotwin.resting import level_of
from conveyor.formats.source import CameraDescription, FrameKey, Refused
from conveyor.messages import Frame

FPS = 30.0
MIDDLE_HEIGHT_M = 0.025
"""Height of a tuber's middle, at which its image row becomes belt travel."""
BETWEEN_TUBERS_M = 0.6
TYPICAL_BELT_M = 0.4
"""Makes belt travel of image rows where the belt distance is not known."""
EPOCH_NS = 1_694_000_000_000_000_000


@dataclass(frozen=True, slots=True)
class _Group:
    """The labels that one camera saw."""

    belt_distance_m: float | None
    labels: tuple[str, ...]


def twin_cameras(path: Path) -> tuple[str, ...]:
    """'2023' for each season of the labels that have images; '2099-0.46' where a season has several distances."""
    return tuple(_groups(path))


class PotatoTwinSource:
    """All tubers of one season, label after label, as frames of one camera with given masks and travel."""

    def __init__(self, path: Path, camera: str) -> None:
        self._path = path
        self._camera = camera
        self._intrinsics, self._depth_scale_m = folder_intrinsics(path)
        group = _groups(path).get(camera, _Group(None, ()))
        self._belt_distance_m = group.belt_distance_m
        self._views = [view for label in group.labels for view in depth_files(path, label)]
        if not self._views:
            raise InputError(f"{path / RGBD / IMAGES} holds no <label>/<label>_depth_<row>.png of season {camera}")

    @property
    def description(self) -> CameraDescription:
        """Intrinsics from the data set, belt distance from its table or the season."""
        level, source = level_of(self._path)
        stated = source != "belt"
        return CameraDescription(
            name=self._camera,
            origin=f"3DPotatoTwin {self._path}, season {self._camera}",
            intrinsics=self._intrinsics,
            depth_scale_m=self._depth_scale_m,
            belt_distance_m=self._belt_distance_m,
            belt_from_camera=None,
            fps=FPS,
            frames=len(self._views),
            resting_offset_mm=1000 * level.offset_m if stated else None,
            resting_sd_mm=1000 * level.sd_m if stated else None,
        )

    def frames(self, *, run: str, after: int = -1) -> Iterator[Frame | Refused]:
        """Pictures in the order of label and row. Travel follows the rows; between two tubers the belt runs 0.6 m."""
        metres_per_row = ((self._belt_distance_m or TYPICAL_BELT_M) - MIDDLE_HEIGHT_M) / self._intrinsics.fy
        travel_m, before = 0.0, None
        for seq, view in enumerate(self._views):
            if before is not None:
                same = before.label == view.label
                travel_m += (view.row - before.row) * metres_per_row if same else BETWEEN_TUBERS_M
            before = view
            if seq > after:
                yield self._frame(seq, view, travel_m, run)

    def keys(self) -> list[FrameKey]:
        """One per picture, at 30 frames/s."""
        return [FrameKey(seq, _captured_ns(seq)) for seq in range(len(self._views))]

    def _frame(self, seq: int, view: ViewFile, travel_m: float, run: str) -> Frame | Refused:
        rgb_path = view.path.with_name(view.path.name.replace("_depth_", "_rgb_"))
        pair = read_images(view.path, rgb_path, self._intrinsics)
        if isinstance(pair, Refusal):
            return Refused(seq, pair.reason, pair.text)
        jpeg = cv2.imencode(".jpg", pair.bgr, [cv2.IMWRITE_JPEG_QUALITY, 90])[1]
        return Frame(
            camera=self._camera,
            run=run,
            seq=seq,
            captured_ns=_captured_ns(seq),
            travel_m=travel_m,
            depth_scale_m=self._depth_scale_m,
            intrinsics=self._intrinsics,
            belt_distance_m=self._belt_distance_m,
            depth=pair.depth,
            mask=pair.mask.astype(np.uint16),
            color_jpeg=np.asarray(jpeg, np.uint8).ravel(),
        )


def _captured_ns(seq: int) -> int:
    return EPOCH_NS + round(seq * 1e9 / FPS)


def _groups(path: Path) -> dict[str, _Group]:
    """The cameras by name, sorted.

    Raises:
        InputError: no tuber has a depth image, or the table cannot be used.
    """
    truth = read_truth(path)
    distances: dict[str, dict[float | None, list[str]]] = {}
    if not (labels := image_labels(path)):
        raise InputError(f"{path / RGBD / IMAGES} holds no <label>/<label>_depth_<row>.png of any tuber")
    for label in labels:
        row = truth_of(truth, label)
        distances.setdefault(row.season, {}).setdefault(row.belt_distance_m, []).append(label)
    found = {}
    for season, labels_at in distances.items():
        for distance_m, seen_at in labels_at.items():
            name = season if len(labels_at) == 1 else f"{season}-{UNKNOWN if distance_m is None else distance_m}"
            found[name] = _Group(distance_m, tuple(seen_at))
    return dict(sorted(found.items()))
