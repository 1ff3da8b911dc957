"""Packs of views on disk: shards `views-00000.npz` and `meta.json`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from camera_sim.sim.views import SimulatedView, ViewPlan, ViewSimulator
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
    }
