"""Labelled frames of random belts (`tuberline simulate-belts`) as the network sees them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.formats.packs.belts import belt_shards, read_belt
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
    shards = belt_shards(folder)
    for number, path in enumerate(shards):
        packed = read_belt(path)
        belt = BeltGeometry(packed.intrinsics, packed.belt_from_camera)
        for frame in packed.frames:
            yield LabelledFrame(
                number, frame.depth, frame.labels, packed.kinds, packed.depth_scale_m, belt, frame.travel_m
            )
        on_shard(number + 1, len(shards))


def load_pack(folder: Path, *, on_shard: Callable[[int, int], None] = lambda done, total: None) -> list[LabelledGrid]:
    """All frames of a pack on the network's grid; raises as `pack_frames`."""
    return [labelled_grid(frame) for frame in pack_frames(folder, on_shard=on_shard)]


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
