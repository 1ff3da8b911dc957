"""Simulated views in the layout of the 3DPotatoTwin data set, so that whatever reads that reads these.

One label per tuber. The data set names no belt distance: it is one per season (0.345, 0.460, 0.465 m), so the season of
a label here is the one whose distance its views were made at. The number at the end of a name is the tuber's row.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camera_sim.sim.optics import Optics
from camera_sim.sim.view_setting import ViewPlan
from camera_sim.sim.views import SimulatedView, ViewSimulator
from conveyor.errors import InputError
from conveyor.formats.potatotwin.layout import BELT_DISTANCES_M, season_at
from conveyor.formats.potatotwin.writer import TwinFolderWriter
from conveyor.geometry import deproject

SPLITS = ("train", "train", "train", "val", "test")
"""Of every five tubers, as in the paper: 60 % train, 20 % each validation and test."""
SKIN_BGR = (92, 148, 186)


def write_twin_folder(
    out: Path, plan: ViewPlan, *, tubers: int, on_tuber: Callable[[int], None] = lambda _: None
) -> int:
    """Simulate `tubers` tubers and write images, clouds and tables under `out`; returns how many views were made.

    Raises:
        InputError: several resolutions, a depth unit that is not 1 mm, or a belt distance of no season.
    """
    optics = _checked(plan)
    simulator = ViewSimulator(plan)
    made = 0
    with TwinFolderWriter(out, optics.intrinsics, name="simulated") as writer:
        for tuber_id in range(tubers):
            label, views = f"S{plan.seed}-{tuber_id:05d}", list(simulator.views(tuber_id))
            if views:
                writer.add_tuber(_truth_row(label, views[0]), split=SPLITS[tuber_id % len(SPLITS)])
                _write_views(writer, label, views)
                made += len(views)
            on_tuber(tuber_id)
    return made


def _checked(plan: ViewPlan) -> Optics:
    if plan.optics is None or plan.fine_unit_share > 0:
        raise InputError("the 3DPotatoTwin layout has one camera and 1 mm depth: choose --camera d405-1280 or d405-848")
    known = sorted(BELT_DISTANCES_M.values())
    other = [d for d in plan.distances_m if season_at(d) is None]
    if other or plan.distance_range_m is not None:
        raise InputError(
            f"belt distance {other[0] if other else 'of any kind'}: the 3DPotatoTwin layout has one per season, "
            f"{', '.join(f'{d:g}' for d in known)} m; choose --distances among them"
        )
    return plan.optics


def _truth_row(label: str, view: SimulatedView) -> dict[str, Any]:
    tuber = view.tuber
    length, width, depth = tuber.axes_mm
    volume = round(tuber.volume_ml, 2)
    return {
        "label": label,
        "unique_id": view.tuber_id,
        "growing_season": season_at(view.belt_distance_m),
        "cultivar": tuber.stock.cultivar,
        "weight_g_inctack": round(tuber.weight_g, 2),
        "x1_length_mm": round(length, 2),
        "x2_width_mm": round(width, 2),
        "x3_depth_mm": round(depth, 2),
        "volume_ml": volume,
        "volume_metashape": volume,
    }


def _write_views(writer: TwinFolderWriter, label: str, views: list[SimulatedView]) -> None:
    taken: set[int] = set()
    for view in views:
        row = int(np.clip(round(view.v_centre), 0, view.intrinsics.height - 1))
        while row in taken:  # two views of one row: the next free one, for the name has to be its own
            row = (row + 1) % view.intrinsics.height
        taken.add(row)
        depth = _whole(view)
        points = deproject(depth, depth_scale_m=view.depth_scale_m, intrinsics=view.intrinsics)
        writer.add_view(label, row, depth=depth, rgba=_rgba(depth), points=points)


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
