"""Labelled frames of random belts (`tuberline simulate-belts`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from conveyor.formats.packs.belts import belt_shards, read_belt
from segmenter.frame.belt import BeltGeometry

HEIGHT_STEP_MM = 0.01


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
