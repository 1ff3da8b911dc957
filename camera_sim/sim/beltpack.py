"""Packs of labelled frames of random belts on disk: shards `belts-00000.npz`, one per belt, and `meta.json`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from camera_sim.sim.belt_scenes import BeltView, random_belt_views
from conveyor import __version__


def write_belt_pack(
    out: Path,
    *,
    belts: int,
    frames: int,
    tubers: int,
    seed: int,
    command: str,
    hard_negatives: bool = False,
    on_belt: Callable[[int], None] = lambda _: None,
) -> int:
    """Simulate `belts` belts and write `frames` frames of each under `out`; returns how many frames were made.

    A shard holds, for its n frames: `depth` and `labels` as PNG files (16 bit, one channel) one after the other, with
    `depth_offset` and `labels_offset` (n + 1,); `kinds` (bodies,) kind of label 1, 2, ...; `depth_scale_m`;
    `intrinsics` (4,) fx fy cx cy; `image_size` (2,) width height; `belt_from_camera` (4, 4); `travel_m` (n,).
    """
    out.mkdir(parents=True, exist_ok=True)
    made = 0
    for belt in range(belts):
        views = list(random_belt_views(seed, belt, frames=frames, tubers=tubers, hard_negatives=hard_negatives))
        np.savez(out / f"belts-{belt:05d}.npz", **_packed(views))
        made += len(views)
        on_belt(belt)
    meta = {
        "command": command,
        "seed": seed,
        "belts": belts,
        "frames": made,
        "tubers_per_belt": tubers,
        "hard_negatives": hard_negatives,
        "tuberline": __version__,
        "numpy": np.__version__,
    }
    (out / "meta.json").write_text(json.dumps(meta, indent=1) + "\n", encoding="utf-8")
    return made


def _packed(views: list[BeltView]) -> dict[str, Any]:
    depth, depth_offset = _files([view.depth for view in views])
    labels, labels_offset = _files([view.labels for view in views])
    k = views[0].intrinsics
    return {
        "depth": depth,
        "depth_offset": depth_offset,
        "labels": labels,
        "labels_offset": labels_offset,
        "kinds": np.array(views[0].kinds),
        "depth_scale_m": np.array(views[0].depth_scale_m),
        "intrinsics": np.array([k.fx, k.fy, k.cx, k.cy]),
        "image_size": np.array([k.width, k.height], np.int32),
        "belt_from_camera": views[0].belt_from_camera,
        "travel_m": np.array([view.travel_m for view in views]),
    }


def _files(images: list[NDArray[np.uint16]]) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """All images as PNG files in a row, and where each begins."""
    files = [cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].ravel() for image in images]
    offsets = np.cumsum([0] + [len(file) for file in files]).astype(np.int64)
    return np.concatenate(files).astype(np.uint8), offsets
