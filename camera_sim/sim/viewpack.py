"""Packs of views on disk: shards `views-00000.npz` and `meta.json`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from camera_sim.sim.view_setting import ViewPlan
from camera_sim.sim.views import SimulatedView, ViewSimulator
from conveyor import __version__

VIEWS_PER_SHARD = 1500


def write_view_pack(
    out: Path, plan: ViewPlan, *, tubers: int, command: str, on_tuber: Callable[[int], None] = lambda _: None
) -> int:
    """Simulate `tubers` tubers and write their views under `out`; returns how many views were made.

    A shard holds, for its n views: `depth` all crops one after the other (uint16, 0 outside the mask), `depth_offset`
    (n+1,), `crop` (n, 4) u0 v0 h w, `depth_scale_m`, `intrinsics` (n, 4) fx fy cx cy, `image_size` (n, 2) width height,
    `belt_distance_m` and `belt_sd_m` (how well it is known), `weight_g`, `volume_ml`, `length_mm`, `width_mm`,
    `height_mm` (sorted caliper axes), `tuber` (the same number in all views of a tuber), `cultivar`, `season`,
    `v_centre`.

    Of its recording: `recording` (its number), `preset`, `surface`, `resting_recording_mm` (how far ordinary undersides
    lie below the belt plane that the camera sees), `stated_resting_mm` and `stated_resting_sd_mm` (what a user would
    state of it), `calibrated` (after a calibration), `soil_mm` (mean thickness of what sticks to its tubers),
    `local_noise_px` (NaN: as the preset has it). Of the view:
    `resting_mm` (how far this underside lies below that plane), `pose` with `shortest_deg` and `longest_deg` (of those
    axes to the vertical), `rim` with `rim_lost` and `skin_lost` (see `view_truth`).
    """
    out.mkdir(parents=True, exist_ok=True)
    simulator = ViewSimulator(plan)
    pending: list[SimulatedView] = []
    made = shards = 0
    for tuber_id in range(tubers):
        pending += simulator.views(tuber_id)
        if len(pending) >= VIEWS_PER_SHARD or tuber_id == tubers - 1:
            np.savez_compressed(out / f"views-{shards:05d}.npz", **pack_views(pending))
            made, shards, pending = made + len(pending), shards + 1, []
        on_tuber(tuber_id)
    meta = {
        "command": command,
        "seed": plan.seed,
        "preset": plan.preset,
        "camera": plan.optics.name if plan.optics else "mixed",
        "tubers": tubers,
        "views": made,
        "shards": shards,
        "tuberline": __version__,
        "numpy": np.__version__,
    }
    (out / "meta.json").write_text(json.dumps(meta, indent=1) + "\n", encoding="utf-8")
    return made


def pack_views(views: list[SimulatedView]) -> dict[str, Any]:
    """The arrays of one shard, by name."""
    sizes = [view.depth.size for view in views]
    k = [view.intrinsics for view in views]
    return {
        "depth": np.concatenate([view.depth.ravel() for view in views]),
        "depth_offset": np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
        "crop": np.array([(view.u0, view.v0, *view.depth.shape) for view in views], np.int32),
        "depth_scale_m": np.array([view.depth_scale_m for view in views]),
        "intrinsics": np.array([(i.fx, i.fy, i.cx, i.cy) for i in k]),
        "image_size": np.array([(i.width, i.height) for i in k], np.int32),
        "belt_distance_m": np.array([view.belt_distance_m for view in views]),
        "belt_sd_m": np.array([view.belt_sd_m for view in views]),
        "weight_g": np.array([view.tuber.weight_g for view in views]),
        "volume_ml": np.array([view.tuber.volume_ml for view in views]),
        "length_mm": np.array([view.tuber.axes_mm[0] for view in views]),
        "width_mm": np.array([view.tuber.axes_mm[1] for view in views]),
        "height_mm": np.array([view.tuber.axes_mm[2] for view in views]),
        "tuber": np.array([view.tuber_id for view in views], np.int64),
        "cultivar": np.array([view.tuber.stock.cultivar for view in views]),
        "season": np.array([view.tuber.stock.season for view in views]),
        "v_centre": np.array([view.v_centre for view in views]),
        **_world_arrays(views),
    }


def _world_arrays(views: list[SimulatedView]) -> dict[str, Any]:
    """What each view shares with its recording, how its tuber lies and how much of its picture was lost."""
    worlds, stated = [view.conditions for view in views], [view.stated for view in views]
    return {
        "recording": np.array([view.recording for view in views], np.int64),
        "preset": np.array([world.preset.name for world in worlds]),
        "surface": np.array([world.surface.kind for world in worlds]),
        "soil_mm": 1000 * np.array([world.jacket_m for world in worlds]),
        "local_noise_px": np.array([np.nan if world.local_px is None else world.local_px for world in worlds]),
        "resting_mm": 1000 * np.array([view.resting_m for view in views]),
        "resting_recording_mm": 1000 * np.array([world.resting_m for world in worlds]),
        "stated_resting_mm": 1000 * np.array([rest.offset_m for rest in stated]),
        "stated_resting_sd_mm": 1000 * np.array([rest.sd_m for rest in stated]),
        "calibrated": np.array([rest.calibrated for rest in stated]),
        "pose": np.array([view.pose.kind for view in views]),
        "shortest_deg": np.array([view.pose.shortest_deg for view in views]),
        "longest_deg": np.array([view.pose.longest_deg for view in views]),
        "rim": np.array([view.rim.kind for view in views]),
        "rim_lost": np.array([view.rim.lost for view in views]),
        "skin_lost": np.array([view.rim.skin_lost for view in views]),
    }
