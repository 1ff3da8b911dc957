"""Simulated views in the layout of the 3DPotatoTwin data set, so that whatever reads that reads these.

One label per tuber. The data set names no belt distance: it is one per season (0.345, 0.460, 0.465 m), so the season of
a label here is the one whose distance its views were made at. The number at the end of a name is the tuber's row.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from camera_sim.sim.optics import Optics
from camera_sim.sim.view_setting import ViewPlan
from camera_sim.sim.views import SimulatedView, ViewSimulator
from conveyor.errors import InputError
from conveyor.formats.potatotwin import BELT_DISTANCES_M
from conveyor.geometry import deproject

SPLITS = ("train", "train", "train", "val", "test")
"""Of every five tubers, as in the paper: 60 % train, 20 % each validation and test."""
SKIN_BGR = (92, 148, 186)
COLUMNS = (
    "label", "unique_id", "growing_season", "cultivar", "weight_g_inctack", "x1_length_mm", "x2_width_mm",
    "x3_depth_mm", "volume_ml", "volume_metashape",
)  # fmt: skip


def write_twin_folder(
    out: Path, plan: ViewPlan, *, tubers: int, on_tuber: Callable[[int], None] = lambda _: None
) -> int:
    """Simulate `tubers` tubers and write images, clouds and tables under `out`; returns how many views were made.

    Raises:
        InputError: several resolutions, a depth unit that is not 1 mm, or a belt distance of no season.
    """
    optics = _checked(plan)
    rgbd = out / "1_rgbd"
    (rgbd / "0_camera_intrinsics").mkdir(parents=True, exist_ok=True)
    intrinsics = json.dumps(_intrinsics(optics), indent=1) + "\n"
    (rgbd / "0_camera_intrinsics" / "simulated_camera_intrinsic.json").write_text(intrinsics, encoding="utf-8")
    simulator = ViewSimulator(plan)
    made = 0
    with (out / "ground_truth.csv").open("w", newline="") as truth, (out / "splits.csv").open("w", newline="") as split:
        truth_rows, split_rows = csv.DictWriter(truth, COLUMNS), csv.writer(split)
        truth_rows.writeheader()
        split_rows.writerow(["label", "split"])
        for tuber_id in range(tubers):
            label, views = f"S{plan.seed}-{tuber_id:05d}", list(simulator.views(tuber_id))
            if views:
                truth_rows.writerow(_truth_row(label, views[0]))
                split_rows.writerow([label, SPLITS[tuber_id % len(SPLITS)]])
                _write_views(rgbd, label, views)
                made += len(views)
            on_tuber(tuber_id)
    return made


def _checked(plan: ViewPlan) -> Optics:
    if plan.optics is None or plan.fine_unit_share > 0:
        raise InputError("the 3DPotatoTwin layout has one camera and 1 mm depth: choose --camera d405-1280 or d405-848")
    known = sorted(BELT_DISTANCES_M.values())
    other = [d for d in plan.distances_m if _season(d) is None]
    if other or plan.distance_range_m is not None:
        raise InputError(
            f"belt distance {other[0] if other else 'of any kind'}: the 3DPotatoTwin layout has one per season, "
            f"{', '.join(f'{d:g}' for d in known)} m; choose --distances among them"
        )
    return plan.optics


def _season(distance_m: float) -> str | None:
    return next((season for season, d in BELT_DISTANCES_M.items() if abs(d - distance_m) < 1e-6), None)


def _intrinsics(optics: Optics) -> dict[str, Any]:
    """Open3D's layout: the matrix column by column, `depth_scale` in units per metre."""
    k = optics.intrinsics
    matrix = [k.fx, 0.0, 0.0, 0.0, k.fy, 0.0, k.cx, k.cy, 1.0]
    return {"width": k.width, "height": k.height, "depth_scale": 1000.0, "intrinsic_matrix": matrix}


def _truth_row(label: str, view: SimulatedView) -> dict[str, Any]:
    tuber = view.tuber
    length, width, depth = tuber.axes_mm
    volume = round(tuber.volume_ml, 2)
    return {
        "label": label,
        "unique_id": view.tuber_id,
        "growing_season": _season(view.belt_distance_m),
        "cultivar": tuber.stock.cultivar,
        "weight_g_inctack": round(tuber.weight_g, 2),
        "x1_length_mm": round(length, 2),
        "x2_width_mm": round(width, 2),
        "x3_depth_mm": round(depth, 2),
        "volume_ml": volume,
        "volume_metashape": volume,
    }


def _write_views(rgbd: Path, label: str, views: list[SimulatedView]) -> None:
    images, clouds = rgbd / "1_image" / label, rgbd / "2_pcd" / label
    images.mkdir(parents=True, exist_ok=True)
    clouds.mkdir(parents=True, exist_ok=True)
    taken: set[int] = set()
    for view in views:
        row = int(np.clip(round(view.v_centre), 0, view.intrinsics.height - 1))
        while row in taken:  # two views of one row: the next free one, for the name has to be its own
            row = (row + 1) % view.intrinsics.height
        taken.add(row)
        depth = _whole(view)
        _write_png(images / f"{label}_depth_{row:03d}.png", depth)
        _write_png(images / f"{label}_rgb_{row:03d}.png", _rgba(depth))
        points = deproject(depth, depth_scale_m=view.depth_scale_m, intrinsics=view.intrinsics)
        write_ply(clouds / f"{label}_pcd_{row:03d}.ply", points)


def _whole(view: SimulatedView) -> NDArray[np.uint16]:
    """(H, W) uint16, the view's crop in its image."""
    image = np.zeros((view.intrinsics.height, view.intrinsics.width), np.uint16)
    height, width = view.depth.shape
    image[view.v0 : view.v0 + height, view.u0 : view.u0 + width] = view.depth
    return image


def _rgba(depth: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """(H, W, 4) uint8: skin, darker towards the flanks; alpha 255 where the tuber was measured."""
    image = np.zeros((*depth.shape, 4), np.uint8)
    inside = depth > 0
    near, far = (float(n) for n in np.percentile(depth[inside], [1, 99]))
    light = np.clip(1.1 - 0.6 * (depth[inside] - near) / max(far - near, 1.0), 0.4, 1.1)
    image[inside, :3] = np.clip(light[:, None] * np.array(SKIN_BGR), 0, 255).astype(np.uint8)
    image[inside, 3] = 255
    return image


def _write_png(path: Path, image: NDArray[Any]) -> None:
    if not cv2.imwrite(str(path), image, [cv2.IMWRITE_PNG_COMPRESSION, 3]):
        raise InputError(f"{path} cannot be written; is the disk full?")


def write_ply(path: Path, points_m: NDArray[np.floating]) -> None:
    """A binary PLY file of (N, 3) points, metres, as float64 like those of the data set."""
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points_m)}\n"
    header += "".join(f"property double {axis}\n" for axis in "xyz") + "end_header\n"
    path.write_bytes(header.encode() + points_m.astype("<f8").tobytes())
