"""A folder in the layout of 3DPotatoTwin with ellipsoids in it, for tests of what trainings and studies read."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from tests.regressor.ellipsoids import D405, DENSITY, ellipsoid_depth_m


def write_twin(
    folder: Path,
    *,
    tubers: int,
    belt_distance_m: float = 0.42,
    seed: int = 0,
    weights_g: Sequence[str] | None = None,
    more: Mapping[str, Sequence[str]] | None = None,
) -> list[str]:
    """One picture of each of t000, t001, ...; their labels.

    Args:
        weights_g: as they stand in the table; the ellipsoids' own where none are given. more: further columns.
    """
    rng = np.random.default_rng(seed)
    cameras = folder / "1_rgbd" / "0_camera_intrinsics"
    cameras.mkdir(parents=True)
    matrix = [D405.fx, 0, 0, 0, D405.fy, 0, D405.cx, D405.cy, 1]
    told = {"width": 1280, "height": 720, "intrinsic_matrix": matrix, "depth_scale": 1000}
    (cameras / "camera_intrinsic.json").write_text(json.dumps(told), encoding="utf-8")
    labels = [f"t{number:03d}" for number in range(tubers)]
    rows = [",".join(("label,growing_season,cultivar,weight_g_inctack,belt_distance_m", *(more or {})))]
    for number, label in enumerate(labels):
        a, b, c = np.exp(rng.normal(np.log([0.04, 0.032, 0.027]), 0.15))
        _write_view(folder / "1_rgbd" / "1_image" / label, label, (a, b, c), belt_distance_m)
        weight_g = weights_g[number] if weights_g else f"{DENSITY * 4e6 / 3 * np.pi * a * b * c:.1f}"
        columns = [values[number] for values in (more or {}).values()]
        rows.append(",".join((label, "2026", "Elstar", weight_g, str(belt_distance_m), *columns)))
    (folder / "ground_truth.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return labels


def _write_view(folder: Path, label: str, half_axes_m: tuple[float, float, float], belt_distance_m: float) -> None:
    folder.mkdir(parents=True)
    depth_m = ellipsoid_depth_m(half_axes_m, belt_distance_m=belt_distance_m)
    mask = np.zeros((*depth_m.shape, 4), np.uint8)
    mask[..., 3] = 255 * (depth_m > 0)
    cv2.imwrite(str(folder / f"{label}_depth_360.png"), np.round(1000 * depth_m).astype(np.uint16))
    cv2.imwrite(str(folder / f"{label}_rgb_360.png"), mask)


def write_parts(folder: Path, parts: Mapping[str, Sequence[str]]) -> None:
    """splits.csv with the labels of each part."""
    rows = [f"{label},{part}" for part, labels in parts.items() for label in labels]
    (folder / "splits.csv").write_text("\n".join(["label,split", *rows]) + "\n", encoding="utf-8")
