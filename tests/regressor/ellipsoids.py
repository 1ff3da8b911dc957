"""Ellipsoids lying on a belt, seen by a pinhole camera: views with a known truth for the regressor's tests."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from conveyor.geometry import Intrinsics, straight_down_belt_from_camera
from conveyor.messages import View
from conveyor.messages.views import LATER_PARTS

D405 = Intrinsics(width=1280, height=720, fx=653.8, fy=652.1, cx=643.5, cy=366.1)
DENSITY = 1.07


def ellipsoid_depth_m(
    half_axes_m: tuple[float, float, float],
    *,
    belt_distance_m: float = 0.345,
    centre_m: tuple[float, float] = (0.0, 0.0),
    tilt_deg: float = 0.0,
    intrinsics: Intrinsics = D405,
) -> NDArray[np.float64]:
    """(height, width) depth along the optical axis, metres, 0 off the tuber.

    The camera looks down from `belt_distance_m` above the belt, turned by `tilt_deg` about its x axis.
    """
    out = np.zeros((intrinsics.height, intrinsics.width))
    rows, columns, depth_m = _window(half_axes_m, belt_distance_m, centre_m, tilt_deg, intrinsics)
    out[rows, columns] = depth_m
    return out


def _window(
    half_axes_m: tuple[float, float, float],
    belt_distance_m: float,
    centre_m: tuple[float, float],
    tilt_deg: float,
    intrinsics: Intrinsics,
) -> tuple[slice, slice, NDArray[np.float64]]:
    """Rows and columns of the image that hold the tuber, and its depth there as `ellipsoid_depth_m` has it."""
    # Only a window around the tuber is computed: generously, as a tilted camera sees it elsewhere.
    reach = int(1.6 * intrinsics.fx * max(half_axes_m) / (belt_distance_m - 2 * half_axes_m[2])) + 8
    middle = tilt_matrix(tilt_deg) @ [*centre_m, belt_distance_m]
    row = int(intrinsics.cy + intrinsics.fy * middle[1] / middle[2])
    column = int(intrinsics.cx + intrinsics.fx * middle[0] / middle[2])
    rows = slice(max(0, row - reach), min(intrinsics.height, row + reach))
    columns = slice(max(0, column - reach), min(intrinsics.width, column + reach))
    # A level ray: one number of each column, and two of each row.
    across = (np.arange(columns.start, columns.stop) - intrinsics.cx) / intrinsics.fx / half_axes_m[0]
    image_y = (np.arange(rows.start, rows.stop)[:, None] - intrinsics.cy) / intrinsics.fy
    _, (_, along_y, ahead_y), (_, along, ahead) = tilt_matrix(tilt_deg)
    along, ahead = (image_y * along_y + along) / half_axes_m[1], (image_y * ahead_y + ahead) / half_axes_m[2]
    centre = np.array([*centre_m, belt_distance_m - half_axes_m[2]])
    offset = centre / half_axes_m
    a = across**2 + along**2 + ahead**2
    b, c = across * offset[0] + along * offset[1] + ahead * offset[2], (offset**2).sum() - 1
    root = b * b - a * c
    return rows, columns, np.where(root > 0, (b - np.sqrt(np.maximum(root, 0))) / a, 0.0)


def upper_side(belt_distance_m: float) -> NDArray[np.float64]:
    """(1500, 3) metres: the upper side of an ellipsoid that lies so far below the camera; no pixels."""
    direction = np.random.default_rng(7).normal(size=(1500, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    direction[:, 2] = -np.abs(direction[:, 2])
    return direction * (0.045, 0.03, 0.025) + (0.0, 0.0, belt_distance_m - 0.025)


def tilt_matrix(tilt_deg: float) -> NDArray[np.float64]:
    """(3, 3) camera_from_level: a turn about x."""
    t = np.deg2rad(tilt_deg)
    return np.array([[1, 0, 0], [0, np.cos(t), -np.sin(t)], [0, np.sin(t), np.cos(t)]])


def ellipsoid_view(
    half_axes_m: tuple[float, float, float] = (0.042, 0.033, 0.028),
    *,
    belt_distance_m: float = 0.345,
    depth_scale_m: float = 0.001,
    centre_m: tuple[float, float] = (0.0, 0.0),
    tilt_deg: float = 0.0,
    name: str = "view/0",
) -> View:
    """A view as the segmenter sends it: the crop inside the mask."""
    below, right, depth_m = _window(half_axes_m, belt_distance_m, centre_m, tilt_deg, D405)
    depth = np.round(depth_m / depth_scale_m).astype(np.uint16)
    rows, columns = np.nonzero(depth.any(1))[0], np.nonzero(depth.any(0))[0]
    belt_from_camera = straight_down_belt_from_camera(belt_distance_m)
    belt_from_camera[:3, :3] = belt_from_camera[:3, :3] @ tilt_matrix(tilt_deg).T
    return View(
        view_id=name,
        track_id=name.rpartition("/")[0],
        camera="front",
        run="run",
        seq=0,
        captured_ns=0,
        rank=0,
        depth_scale_m=depth_scale_m,
        intrinsics=D405,
        u0=right.start + int(columns[0]),
        v0=below.start + int(rows[0]),
        depth=depth[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1],
        belt_from_camera=belt_from_camera,
        takes=LATER_PARTS,
    )


def write_pack(
    folder: Path, *, tubers: int, views: int, seed: int, half_axes_m: tuple[float, float, float] = (0.04, 0.032, 0.027)
) -> None:
    """A view pack of ellipsoids of about these half axes, weight = 1.07 g/ml times their volume."""
    rng = np.random.default_rng(seed)
    made = [
        (tuber, axes, ellipsoid_view(axes, centre_m=(float(rng.normal(0, 0.05)), float(rng.normal(0, 0.03)))))
        for tuber, axes in enumerate(map(tuple, np.exp(rng.normal(np.log(half_axes_m), 0.2, (tubers, 3)))))
        for _ in range(views)
    ]
    volume_ml = np.array([4e6 / 3 * np.pi * np.prod(axes) for _, axes, _ in made])
    sizes = [view.depth.size for *_, view in made]
    folder.mkdir(parents=True, exist_ok=True)
    np.savez(
        folder / "views-00000.npz",
        depth=np.concatenate([view.depth.ravel() for *_, view in made]),
        depth_offset=np.concatenate([[0], np.cumsum(sizes)]),
        crop=np.array([[view.u0, view.v0, *view.depth.shape] for *_, view in made]),
        depth_scale_m=np.full(len(made), 0.001),
        intrinsics=np.tile([D405.fx, D405.fy, D405.cx, D405.cy], (len(made), 1)),
        image_size=np.tile([1280, 720], (len(made), 1)),
        belt_distance_m=np.full(len(made), 0.345),
        weight_g=DENSITY * volume_ml,
        volume_ml=volume_ml,
        length_mm=np.array([2e3 * max(axes) for _, axes, _ in made]),
        tuber=np.array([tuber for tuber, *_ in made]),
        cultivar=np.full(len(made), "Ellipsoid"),
        season=np.full(len(made), "2026"),
        v_centre=np.array([view.v0 + view.depth.shape[0] / 2 for *_, view in made]),
    )
    (folder / "meta.json").write_text(json.dumps({"seed": seed}), encoding="utf-8")
