"""The belts of `benchmarks line`: as many tubers a second as asked for, evenly or in bursts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

from camera_sim.sim.placement import Packing
from camera_sim.sim.presets import PRESETS
from camera_sim.sim.record import record_scene
from camera_sim.sim.scenes import Layout, SceneSettings, build_world, layout_named
from conveyor.errors import TuberlineError

Load = Literal["even", "bursts"]
SCENES = {1: "touching", 2: "two-cameras"}
SLOWEST_MPS, FASTEST_MPS = 0.05, 1.2
APART = Packing(tries=3, touching=0.3, gap_m=0.0, aside_m=0.0)
"""Its gap is the one that a rate needs."""
WIDEST_GAP_M = 2.0
"""Between two tubers that do not touch, in the mean."""
HALVINGS = 12


def simulated_belt(
    path: Path, *, cameras: int, tubers_per_s: float, tubers: int, fps: float, seed: int, load: Load
) -> None:
    """Record a belt that brings `tubers_per_s` in the mean when it is repeated.

    Args:
        tubers: of one lap. `even`: they lie as far apart as the rate needs at the simulator's own speed; all that is
            bare is a view's length between the laps. `bursts`: they lie as on a full belt, which is as slow or fast as
            it has to be, so that more than the mean come while they come, and none for a view's length.

    Raises:
        TuberlineError: no belt brings that rate.
    """
    layout = layout_named(SCENES[cameras])
    settings = SceneSettings(scene=SCENES[cameras], seed=seed, tubers=tubers, preset=PRESETS["easy"], fps=fps)
    if load == "even":
        record_scene(path, settings, layout=spread(layout, settings, tubers_per_s))
        return
    speed_mps = settings.speed_mps * tubers_per_s / rate_per_s(layout, settings)
    if not SLOWEST_MPS <= speed_mps <= FASTEST_MPS:
        raise TuberlineError(
            f"{tubers_per_s:g} tubers/s in bursts need a belt of {speed_mps:.2f} m/s; allowed are {SLOWEST_MPS:g} to "
            f"{FASTEST_MPS:g}: ask for another rate"
        )
    record_scene(path, replace(settings, speed_mps=round(speed_mps, 4)), layout=layout)


def rate_per_s(layout: Layout, settings: SceneSettings) -> float:
    """Tubers a second in the mean, when the belt is repeated."""
    return settings.tubers / build_world(settings, layout).motion.duration_s


def spread(layout: Layout, settings: SceneSettings, tubers_per_s: float) -> Layout:
    """The layout with the mean gap that brings the asked rate at the belt's speed, found by halving."""
    low_m, high_m = 0.0, WIDEST_GAP_M
    most, least = (rate_per_s(with_gap(layout, gap_m), settings) for gap_m in (low_m, high_m))
    if not least <= tubers_per_s <= most:
        raise TuberlineError(
            f"{tubers_per_s:g} tubers/s lie evenly on no belt of {settings.speed_mps:g} m/s with {settings.tubers} "
            f"tubers; possible are {least:.1f} to {most:.1f} tubers/s: ask for more --tubers, another rate, or bursts"
        )
    for _ in range(HALVINGS):
        middle_m = (low_m + high_m) / 2
        if rate_per_s(with_gap(layout, middle_m), settings) > tubers_per_s:
            low_m = middle_m
        else:
            high_m = middle_m
    return with_gap(layout, high_m)


def with_gap(layout: Layout, gap_m: float) -> Layout:
    """The layout with its tubers apart, with this mean gap ahead of a tuber that touches none."""
    return replace(layout, packing=replace(APART, gap_m=gap_m))
