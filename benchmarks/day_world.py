"""The simulated day: two plots, a machine with a one-row share, twenty boxes, three varieties, one line of two cameras.

Everything is drawn from one seed; what a load's belt looks like is drawn from the seed and its number.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from benchmarks.sizes_belts import MAYQUEEN
from camera_sim.sim.conditions import Conditions
from camera_sim.sim.cultivars import STOCKS, Stock
from camera_sim.sim.field import FieldWorld, MachineDay, SimulatedField, simulate_field
from camera_sim.sim.placement import CROWDED
from camera_sim.sim.presets import FIELD_PRESET
from camera_sim.sim.scenes import Layout, SceneSettings, layout_named
from conveyor.geometry import EARTH_M_PER_DEG

SEED = 8801
"""Fixed before anything was run."""
CAMERAS = ("left", "right")
FIELDS = ("North plot", "South plot")
LOADS_A_FIELD = 10
SAYAKA, KITAHIME = STOCKS[0], STOCKS[4]
VARIETIES: tuple[Stock, ...] = (SAYAKA,) * 7 + (KITAHIME,) * 6 + (MAYQUEEN,) * 7
"""By load. The weights were trained on the first two; no tuber of the third was in any training or choice."""

DAY = datetime(2026, 10, 6, 8, 0, tzinfo=UTC)
PLOT = FieldWorld(
    size_m=(5.25, 30.0),
    mean_t_ha=45.0,
    contrast=0.2,
    patch_m=6.0,
    width_m=0.75,
    overlap_m=0.0,
    speed_m_s=0.3,
    stop_every_s=0.0,
    stop_s=30.0,
    box_kg=58.0,
    delay_s=9.0,
    mixing_s=0.7,
    noise_m=0.03,
    jump_m=8.0,
    outages=2,
    tuber_g=165.0,
    shown_share=1.0,
    origin_lat_deg=52.7,
    origin_lon_deg=5.75,
    start_ns=int(DAY.timestamp()) * 10**9,
)
BETWEEN_PLOTS_M = 6.0
LUNCH_S = 1500
SPEED_MPS, FPS = 0.75, 15.0
OTHERS = 0.06
"""Clods, stones and haulm for each tuber."""

CAMERA_SCALE, CAMERA_DRIFT_PX = 1.004, 0.1
RESTING_MM, RESTING_BY_LOAD_MM = 4.0, 0.4
"""Tubers lie so far below the belt as stated, and from load to load by so much more or less (standard deviation)."""
SCATTER_M = 0.0006
SCALE_ERROR = 0.005

GAPS: dict[int, tuple[tuple[str, ...], float, float]] = {
    4: (CAMERAS, 0.40, 0.65),
    9: (("left",), 0.30, 0.65),
    13: (("right",), 0.20, 0.60),
    17: (CAMERAS, 0.45, 0.85),
}
"""By load: cameras that deliver nothing, from which to which share of its frames."""


@dataclass(frozen=True, slots=True)
class LoadPlan:
    """One load: its number from 1, its field, its variety, and (N,) when its tubers cross, Unix ns, ascending."""

    number: int
    field: str
    stock: Stock
    crossed_ns: NDArray[np.int64]

    @property
    def name(self) -> str:
        """As it is written on the box."""
        return f"box {self.number}"

    @property
    def tubers(self) -> int:
        """How many are laid on its belt."""
        return len(self.crossed_ns)


@dataclass(frozen=True, slots=True, eq=False)
class DayPlan:
    """The day before any frame: plots with their truth, loads, and the machine's positions of both plots."""

    seed: int
    plots: tuple[SimulatedField, ...]
    loads: tuple[LoadPlan, ...]
    lifted: tuple[NDArray[np.float64], ...]
    """By load: (N, 2) where each of its tubers grew, metres east and north of the first plot's corner."""
    positions: NDArray[np.float64]
    """(P, 4) Unix seconds, latitude, longitude, quality."""


def plan_day(seed: int = SEED, *, loads: int = 2 * LOADS_A_FIELD, box_kg: float | None = None) -> DayPlan:
    """Draw the day; fewer `loads` and smaller boxes make a small one."""
    world = PLOT if box_kg is None else replace(PLOT, box_kg=box_kg)
    plots, planned, lifted, positions = [], [], [], []
    start_ns, east_m = world.start_ns, 0.0
    of_field = -(-loads // len(FIELDS))
    for n, name in enumerate(FIELDS):
        at = replace(world, start_ns=start_ns, origin_lon_deg=_east_of(world, east_m))
        plot = simulate_field(at, seed=seed + n)
        (machine,) = plot.machines
        ends = _cut(machine, of_field)
        for box in range(min(of_field, loads - n * of_field)):
            mine = machine.box == box
            number = n * of_field + box
            stock = VARIETIES[number * len(VARIETIES) // loads]
            planned.append(LoadPlan(number + 1, name, stock, np.sort(machine.crossed_ns[mine])))
            order = np.argsort(machine.crossed_ns[mine], kind="stable")
            lifted.append(machine.lifted_m[mine][order] + [east_m, 0.0])
        there = machine.time_ns <= ends
        columns = (machine.time_ns / 1e9, machine.lat_deg, machine.lon_deg, machine.quality.astype(float))
        positions.append(np.stack(columns, axis=1)[there])
        plots.append(plot)
        start_ns, east_m = ends + LUNCH_S * 10**9, east_m + world.size_m[0] + BETWEEN_PLOTS_M
    return DayPlan(seed, tuple(plots), tuple(planned), tuple(lifted), np.concatenate(positions))


def _east_of(world: FieldWorld, east_m: float) -> float:
    return world.origin_lon_deg + east_m / (EARTH_M_PER_DEG * float(np.cos(np.radians(world.origin_lat_deg))))


def _cut(machine: MachineDay, boxes: int) -> int:
    """When the last box was full and its tubers had passed, Unix ns."""
    return int(machine.crossed_ns[machine.box < boxes].max()) + 5 * 10**9


def belt_settings(plan: LoadPlan, seed: int) -> tuple[SceneSettings, Layout]:
    """What is simulated of a load's belt: the same line for all, with its own tubers."""
    rng = np.random.default_rng([seed, 1, plan.number])
    noise = replace(FIELD_PRESET.noise, scale=CAMERA_SCALE, drift_px=CAMERA_DRIFT_PX)
    preset = replace(FIELD_PRESET, noise=noise, belt_error_session_m=0.0)
    layout = replace(layout_named("two-cameras"), packing=CROWDED, distractors=OTHERS)
    settings = SceneSettings(
        scene="two-cameras",
        seed=seed * 100 + plan.number,
        tubers=plan.tubers,
        preset=preset,
        fps=FPS,
        speed_mps=SPEED_MPS,
        resting_offset_mm=RESTING_MM + RESTING_BY_LOAD_MM * float(rng.standard_normal()),
        conditions=Conditions(preset, stock=plan.stock, scatter_m=SCATTER_M),
    )
    return settings, layout
