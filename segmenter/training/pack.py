"""Labelled frames of random belts (`tuberline simulate-belts`)."""

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
    shards = sorted(folder.glob("belts-*.npz"))
    if not shards:
        raise InputError(f"{folder} holds no belts-*.npz: make some with `tuberline simulate-belts --out {folder}`")
    for number, path in enumerate(shards):
        try:
            with np.load(path) as shard:
                frames = list(_shard(shard, number))
        except (OSError, ValueError, KeyError) as error:
            raise InputError(f"{path} cannot be read: {error}; make the pack again") from error
        yield from frames
        on_shard(number + 1, len(shards))


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
        raise InputError(f"{path} cannot be read: {error}; make the pack again") from error
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


def _images(shard: np.lib.npyio.NpzFile, name: str) -> Iterator[NDArray[np.uint16]]:
    data, offsets = shard[name], shard[f"{name}_offset"]
    for first, last in zip(offsets[:-1].tolist(), offsets[1:].tolist(), strict=True):
        image = cv2.imdecode(data[first:last], cv2.IMREAD_UNCHANGED)
        if image is None or image.dtype != np.uint16:
            raise ValueError(f"image {name} at byte {first} is broken")
        yield np.asarray(image, np.uint16)
