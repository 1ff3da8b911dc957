"""Simulated views as a view pack (`conveyor.formats.packs.views`)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from camera_sim.sim.views import SimulatedView, ViewPlan, ViewSimulator
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
    )
