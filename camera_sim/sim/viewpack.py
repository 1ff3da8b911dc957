"""Simulated views as a view pack (`conveyor.formats.packs.views`)."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from camera_sim.sim.view_setting import ViewPlan
from camera_sim.sim.views import SimulatedView, ViewSimulator
from conveyor.formats.packs.views import PackedView, ViewPackWriter


def write_view_pack(
    out: Path, plan: ViewPlan, *, tubers: int, command: str, on_tuber: Callable[[int], None] = lambda _: None
) -> int:
    """Simulate `tubers` tubers and write their views under `out`; returns how many views were made."""
    simulator = ViewSimulator(plan)
    meta = {
        "command": command,
        "seed": plan.seed,
        "preset": plan.preset,
        "camera": plan.optics.name if plan.optics else "mixed",
        "tubers": tubers,
    }
    with ViewPackWriter(out, meta=meta) as writer:
        for tuber_id in range(tubers):
            writer.add([packed(view) for view in simulator.views(tuber_id)])
            on_tuber(tuber_id)
    return writer.views


def packed(view: SimulatedView) -> PackedView:
    """A simulated view as a pack holds it; what the format does not name goes to `more`."""
    length_mm, width_mm, height_mm = view.tuber.axes_mm
    return PackedView(
        depth=view.depth,
        u0=view.u0,
        v0=view.v0,
        intrinsics=view.intrinsics,
        depth_scale_m=view.depth_scale_m,
        belt_distance_m=view.belt_distance_m,
        belt_sd_m=view.belt_sd_m,
        weight_g=view.tuber.weight_g,
        volume_ml=view.tuber.volume_ml,
        length_mm=length_mm,
        width_mm=width_mm,
        height_mm=height_mm,
        tuber=view.tuber_id,
        cultivar=view.tuber.stock.cultivar,
        season=view.tuber.stock.season,
        v_centre=view.v_centre,
        more=_world(view),
    )


def _world(view: SimulatedView) -> dict[str, Any]:
    """What a view shares with its recording, how its tuber lies and how much of its picture was lost.

    `recording` (its number), `preset`, `surface`, `resting_recording_mm` (how far ordinary undersides lie below the
    belt plane that the camera sees), `stated_resting_mm` and `stated_resting_sd_mm` (what a user would state of
    it), `calibrated` (after a calibration), `soil_mm` (mean thickness of what sticks to its tubers),
    `local_noise_px` (NaN: as the preset has it). Of the view: `resting_mm` (how far this underside lies below that
    plane), `pose` with `shortest_deg` and `longest_deg` (of those axes to the vertical), `rim` with `rim_lost` and
    `skin_lost` (see `view_truth`).
    """
    world, stated = view.conditions, view.stated
    return {
        "recording": view.recording,
        "preset": world.preset.name,
        "surface": world.surface.kind,
        "soil_mm": 1000 * world.jacket_m,
        "local_noise_px": math.nan if world.local_px is None else world.local_px,
        "resting_mm": 1000 * view.resting_m,
        "resting_recording_mm": 1000 * world.resting_m,
        "stated_resting_mm": 1000 * stated.offset_m,
        "stated_resting_sd_mm": 1000 * stated.sd_m,
        "calibrated": stated.calibrated,
        "pose": view.pose.kind,
        "shortest_deg": view.pose.shortest_deg,
        "longest_deg": view.pose.longest_deg,
        "rim": view.rim.kind,
        "rim_lost": view.rim.lost,
        "skin_lost": view.rim.skin_lost,
    }
