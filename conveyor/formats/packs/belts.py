"""Belt packs: labelled frames of random belts, one belt to a shard `belts-00000.npz`, and `meta.json`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError
from conveyor.formats.packs.files import NamedArray, read_meta, read_shard, write_meta
from conveyor.geometry import Intrinsics
from conveyor.pose import pose_fault

VERSION = 1
FORMAT_NAME = "belt pack"
PATTERN = "belts-*.npz"

ARRAYS = (
    NamedArray("depth", "(bytes,)", "uint8, the frames' depth as 16-bit PNG files one after the other"),
    NamedArray("depth_offset", "(n + 1,)", "where each of them begins"),
    NamedArray("labels", "(bytes,)", "uint8, instance labels as 16-bit PNG files, 0 = belt"),
    NamedArray("labels_offset", "(n + 1,)", "where each of them begins"),
    NamedArray("kinds", "(bodies,)", "kind of label 1, 2, ..."),
    NamedArray("depth_scale_m", "()", "metres per unit of depth"),
    NamedArray("intrinsics", "(4,)", "fx, fy, cx, cy, pixels"),
    NamedArray("image_size", "(2,)", "width, height, pixels"),
    NamedArray("belt_from_camera", "(4, 4)", "pose of the camera"),
    NamedArray("travel_m", "(n,)", "how far the belt had moved"),
)


@dataclass(frozen=True, slots=True)
class PackedFrame:
    """One frame of a belt: `depth` (H, W) uint16, units of the belt's scale; `labels` (H, W) uint16, 0 = belt."""

    depth: NDArray[np.uint16]
    labels: NDArray[np.uint16]
    travel_m: float


@dataclass(frozen=True, slots=True)
class PackedBelt:
    """One belt: its camera, the kind of label 1, 2, ... in all of its frames, and the frames."""

    intrinsics: Intrinsics
    belt_from_camera: NDArray[np.float64]
    depth_scale_m: float
    kinds: tuple[str, ...]
    frames: tuple[PackedFrame, ...]


def belt_shards(folder: Path) -> list[Path]:
    """Shards of the pack in `folder`, sorted.

    Raises:
        InputError: there are none.
    """
    shards = sorted(folder.glob(PATTERN))
    if not shards:
        wrong = f"holds no {PATTERN}" if folder.is_dir() else "is a file" if folder.exists() else "is not there"
        raise InputError(f"{folder} {wrong}: name a folder of belts, made with `tuberline simulate-belts --out FOLDER`")
    return shards


def belt_pack_meta(folder: Path) -> dict[str, Any]:
    """What a pack says of itself; nothing where it says nothing.

    Raises:
        InputError: what it says cannot be read, or its version is newer.
    """
    return read_meta(folder, newest=VERSION, what=FORMAT_NAME)


def read_belt(shard: Path) -> PackedBelt:
    """The belt of one shard.

    Raises:
        InputError: unreadable, of a newer version, or with a broken image or pose.
    """
    belt_pack_meta(shard.parent)
    data = read_shard(shard, ARRAYS)
    fault = pose_fault(data["belt_from_camera"])
    if fault:
        raise InputError(f"shard {shard}: {fault}")
    try:
        width, height = (int(n) for n in data["image_size"])
        images = zip(
            _images(data, "depth", shard), _images(data, "labels", shard), data["travel_m"].tolist(), strict=True
        )
        return PackedBelt(
            intrinsics=Intrinsics(width, height, *(float(value) for value in data["intrinsics"])),
            belt_from_camera=np.asarray(data["belt_from_camera"], np.float64),
            depth_scale_m=float(data["depth_scale_m"]),
            kinds=tuple(str(kind) for kind in data["kinds"].tolist()),
            frames=tuple(PackedFrame(depth, labels, travel_m) for depth, labels, travel_m in images),
        )
    except (ValueError, TypeError, IndexError, OverflowError) as error:
        raise InputError(f"shard {shard} cannot be used: {error}; make the pack again") from error


class BeltPackWriter:
    """One shard per belt, then meta.json; use it in a `with`."""

    def __init__(self, out: Path, *, meta: Mapping[str, Any]) -> None:
        self._out = out
        self._meta = dict(meta)
        self.belts = 0
        self.frames = 0

    def __enter__(self) -> Self:
        self._out.mkdir(parents=True, exist_ok=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            write_meta(self._out, version=VERSION, what=self._meta | {"belts": self.belts, "frames": self.frames})

    def add(self, belt: PackedBelt) -> None:
        """Write one belt."""
        np.savez(self._out / f"belts-{self.belts:05d}.npz", **pack_belt(belt))
        self.belts, self.frames = self.belts + 1, self.frames + len(belt.frames)


def pack_belt(belt: PackedBelt) -> dict[str, Any]:
    """The arrays of one shard, by name."""
    depth, depth_offset = _png_files([frame.depth for frame in belt.frames])
    labels, labels_offset = _png_files([frame.labels for frame in belt.frames])
    k = belt.intrinsics
    return {
        "depth": depth,
        "depth_offset": depth_offset,
        "labels": labels,
        "labels_offset": labels_offset,
        "kinds": np.array(belt.kinds),
        "depth_scale_m": np.array(belt.depth_scale_m),
        "intrinsics": np.array([k.fx, k.fy, k.cx, k.cy]),
        "image_size": np.array([k.width, k.height], np.int32),
        "belt_from_camera": belt.belt_from_camera,
        "travel_m": np.array([frame.travel_m for frame in belt.frames]),
    }


def _png_files(images: Sequence[NDArray[np.uint16]]) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """All images as PNG files in a row, and where each begins."""
    files = [cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].ravel() for image in images]
    offsets = np.cumsum([0] + [len(file) for file in files]).astype(np.int64)
    return np.concatenate(files).astype(np.uint8), offsets


def _images(data: dict[str, NDArray[Any]], name: str, shard: Path) -> list[NDArray[np.uint16]]:
    files, offsets = data[name], data[f"{name}_offset"].tolist()
    found = []
    for first, last in pairwise(offsets):
        image = cv2.imdecode(files[first:last], cv2.IMREAD_UNCHANGED) if last > first else None
        if image is None or image.dtype != np.uint16 or image.ndim != 2:
            raise InputError(f"shard {shard}: image {name} at byte {first} is broken; make the pack again")
        found.append(np.asarray(image, np.uint16))
    return found
