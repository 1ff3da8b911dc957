"""Labelled frames of random belts (`tuberline simulate-belts`) as the network sees them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError
from conveyor.geometry import Intrinsics
from segmenter.classes import BELT, GRID_MM, OTHER, STEP, TUBER
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.heights import height_map

HEIGHT_STEP_MM = 0.01
PIXEL_MM = 1.45


@dataclass(frozen=True, slots=True)
class LabelledFrame:
    """One frame of a pack.

    Attributes:
        belt_number: frames of one belt show the same bodies.
        depth: (H, W) uint16, units of `depth_scale_m` metres; labels: (H, W) uint16, 0 = belt.
        kinds: of label 1, 2, ...
        travel_m: how far the belt had moved.
    """

    belt_number: int
    depth: NDArray[np.uint16]
    labels: NDArray[np.uint16]
    kinds: tuple[str, ...]
    depth_scale_m: float
    belt: BeltGeometry
    travel_m: float


@dataclass(frozen=True, slots=True)
class LabelledGrid:
    """One frame on the network's grid; memory is what bounds a training, so heights are kept in 0.01 mm.

    Attributes:
        height: (H, W) uint16, 0.01 mm; seen: (H, W) uint8, 255 = all of the cell was measured. H and W are even.
        classes: (H/2, W/2) uint8; bodies: (H/2, W/2) uint16, number of the body, 0 = belt.
    """

    height: NDArray[np.uint16]
    seen: NDArray[np.uint8]
    classes: NDArray[np.uint8]
    bodies: NDArray[np.uint16]

    @property
    def height_mm(self) -> NDArray[np.float32]:
        """(H, W) float32 millimetres."""
        return self.height.astype(np.float32) * np.float32(HEIGHT_STEP_MM)


def pack_frames(
    folder: Path, *, on_shard: Callable[[int, int], None] = lambda done, total: None
) -> Iterator[LabelledFrame]:
    """All frames of a pack, belt by belt.

    Raises:
        InputError: there is none, or a shard cannot be read.
    """
    shards = sorted(folder.glob("belts-*.npz"))
    if not shards:
        raise InputError(f"{folder} holds no belts-*.npz: make some with `tuberline simulate-belts --out {folder}`")
    for number, path in enumerate(shards):
        try:
            with np.load(path) as shard:
                frames = list(_shard(shard, number))
        except (OSError, ValueError, KeyError) as error:
            raise InputError(f"{path} cannot be read: {error}; make the pack anew") from error
        yield from frames
        on_shard(number + 1, len(shards))


def load_pack(folder: Path, *, on_shard: Callable[[int, int], None] = lambda done, total: None) -> list[LabelledGrid]:
    """All frames of a pack on the network's grid; raises as `pack_frames`."""
    return [labelled_grid(frame) for frame in pack_frames(folder, on_shard=on_shard)]


def pack_origin(folder: Path) -> dict[str, Any]:
    """What a pack says of itself; nothing where it says nothing.

    Raises:
        InputError: what it says cannot be read.
    """
    path = folder / "meta.json"
    if not path.is_file():
        return {}
    try:
        meta = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read: {error}; make the pack anew") from error
    return dict(meta) if isinstance(meta, dict) else {}


def _shard(shard: np.lib.npyio.NpzFile, number: int) -> Iterator[LabelledFrame]:
    width, height = (int(n) for n in shard["image_size"])
    intrinsics = Intrinsics(width, height, *(float(value) for value in shard["intrinsics"]))
    belt = BeltGeometry(intrinsics, shard["belt_from_camera"])
    kinds = tuple(str(kind) for kind in shard["kinds"].tolist())
    scale_m = float(shard["depth_scale_m"])
    images = zip(_images(shard, "depth"), _images(shard, "labels"), shard["travel_m"].tolist(), strict=True)
    for depth, labels, travel_m in images:
        yield LabelledFrame(number, depth, labels, kinds, scale_m, belt, travel_m)


def labelled_grid(frame: LabelledFrame) -> LabelledGrid:
    """One frame on the network's grid."""
    of_kind = np.array([BELT] + [TUBER if kind == "tuber" else OTHER for kind in frame.kinds], np.uint8)
    heights = height_map(frame.depth, depth_scale_m=frame.depth_scale_m, belt=frame.belt, pixel_mm=PIXEL_MM)
    rows, columns = (max(1, round(n * heights.cell_mm / GRID_MM)) // STEP * STEP for n in heights.height_mm.shape)
    how = cv2.INTER_AREA if heights.cell_mm <= GRID_MM else cv2.INTER_LINEAR
    height_mm = cv2.resize(heights.height_mm, (columns, rows), interpolation=how)
    seen = cv2.resize(heights.seen.astype(np.float32), (columns, rows), interpolation=how)
    used = tuple(n * heights.stride for n in heights.height_mm.shape)
    i = ((np.arange(rows // STEP) + 0.5) * used[0] / (rows // STEP)).astype(int)
    j = ((np.arange(columns // STEP) + 0.5) * used[1] / (columns // STEP)).astype(int)
    bodies = frame.labels[i[:, None], j[None, :]]
    return LabelledGrid(
        height=np.clip(height_mm / HEIGHT_STEP_MM + 0.5, 0, 65535).astype(np.uint16),
        seen=(seen * 255 + 0.5).astype(np.uint8),
        classes=of_kind[bodies],
        bodies=bodies,
    )


def _images(shard: np.lib.npyio.NpzFile, name: str) -> Iterator[NDArray[np.uint16]]:
    data, offsets = shard[name], shard[f"{name}_offset"]
    for first, last in zip(offsets[:-1].tolist(), offsets[1:].tolist(), strict=True):
        image = cv2.imdecode(data[first:last], cv2.IMREAD_UNCHANGED)
        if image is None or image.dtype != np.uint16:
            raise ValueError(f"image {name} at byte {first} is broken")
        yield np.asarray(image, np.uint16)
