"""Bias of weights by simulated world, pose and rim: with the belt as stated, and with the true resting offset added.

Tubers are drawn by seed from each preset, a few views each. Bias is that of the total of a class' views, in percent of
its true total; the spread is one standard error over recordings, for tubers of a recording share their world.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.options import parser_of, whole_number
from camera_sim.sim.view_setting import ViewPlan
from camera_sim.sim.views import SimulatedView, ViewSimulator
from conveyor.geometry import straight_down_belt_from_camera

PRESETS = ("easy", "field", "harsh")
METHODS = ("as weighed", "volume rule")
STRIDE = 5
"""Every fifth tuber of the plan is taken, so that a few hundred come from many recordings."""


@dataclass(frozen=True, slots=True)
class Row:
    """One view weighed: grams by (method, belt), whether its interval held, and its classes by grouping."""

    truth_g: float
    grams: dict[str, float]
    held: dict[str, bool]
    recording: int
    classes: dict[str, str]


def main(arguments: Sequence[str]) -> None:
    """Simulate, weigh and print a Markdown table."""
    parser = parser_of("worlds", __doc__)
    parser.add_argument("--tubers", type=whole_number(1), default=200, help="of each preset")
    parser.add_argument("--views", type=whole_number(1), default=2, help="of each tuber")
    parser.add_argument("--seed", type=whole_number(0), default=90417)
    parser.add_argument("--presets", nargs="+", default=list(PRESETS))
    parser.add_argument("--weights", type=Path, help="default: the shipped ones")
    parser.add_argument("--out", type=Path, help="folder for worlds.json and worlds.md")
    given = parser.parse_args(arguments)
    table: list[dict[str, object]] = []
    for preset in given.presets:
        views = simulated(preset, tubers=given.tubers, views=given.views, seed=given.seed)
        rows = weighed(views, given.weights)
        table += [{"preset": preset, **line} for line in by_class(rows)]
    text = markdown(table, seed=given.seed)
    print(text)
    if given.out:
        given.out.mkdir(parents=True, exist_ok=True)
        (given.out / "worlds.json").write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
        (given.out / "worlds.md").write_text(text + "\n", encoding="utf-8")


def simulated(preset: str, *, tubers: int, views: int, seed: int) -> Iterator[SimulatedView]:
    """All views of the tubers of one preset."""
    simulator = ViewSimulator(ViewPlan(seed, views, preset, distance_range_m=(0.30, 0.55)))
    for number in range(tubers):
        yield from simulator.views(number * STRIDE)


def weighed(views: Iterator[SimulatedView], weights: Path | None) -> list[Row]:
    """Each view by the network as shipped and by the volume rule; views that are refused are left out."""
    from regressor.weigh.prepare import RefusedCloud, prepare_depth
    from regressor.weigh.weigher import Weigher

    weigher, rows = Weigher.load(weights), []
    for view in views:
        grams: dict[str, float] = {}
        held: dict[str, bool] = {}
        for belt, offset_m in (("stated", 0.0), ("resting", view.conditions.resting_m)):
            k = view.intrinsics
            try:
                cloud = prepare_depth(
                    view.depth,
                    depth_scale_m=view.depth_scale_m,
                    fx=k.fx,
                    fy=k.fy,
                    cx=k.cx - view.u0,
                    cy=k.cy - view.v0,
                    belt_from_camera=straight_down_belt_from_camera(view.belt_distance_m + offset_m),
                )
            except RefusedCloud:
                break
            answer = weigher.weigh(cloud, belt_sd_m=view.belt_sd_m)
            grams[f"as weighed, {belt}"], grams[f"volume rule, {belt}"] = answer.weight_g, answer.volume_g
            held[belt] = answer.low_g <= view.tuber.weight_g <= answer.high_g
        else:
            rows.append(Row(view.tuber.weight_g, grams, held, view.recording, _classes(view)))
    return rows


def _classes(view: SimulatedView) -> dict[str, str]:
    weight_g = view.tuber.weight_g
    return {
        "all": "all",
        "pose": view.pose.kind,
        "rim": view.rim.kind,
        "surface": view.conditions.surface.kind,
        "weight": "below 100 g" if weight_g < 100 else "100 to 250 g" if weight_g < 250 else "250 g and more",
        "belt distance": f"{round(view.belt_distance_m / 0.05) * 0.05:.2f} m",
        "season": view.tuber.stock.season,
    }


def by_class(rows: list[Row]) -> list[dict[str, object]]:
    """One line of figures per class of each grouping."""
    lines: list[dict[str, object]] = []
    for grouping in rows[0].classes:
        for name in sorted({row.classes[grouping] for row in rows}):
            some = [row for row in rows if row.classes[grouping] == name]
            lines.append({"class": name if grouping == "all" else f"{grouping}: {name}", **figures(some)})
    return lines


def figures(rows: list[Row]) -> dict[str, object]:
    """Views, bias of the total in percent with its standard error over recordings, MAE in grams, share held."""
    truth = np.array([row.truth_g for row in rows])
    recording = np.array([row.recording for row in rows])
    line: dict[str, object] = {"views": len(rows)}
    for belt in ("stated", "resting"):
        for method in METHODS:
            grams = np.array([row.grams[f"{method}, {belt}"] for row in rows])
            line[f"{method}, {belt}"] = _bias_percent(grams, truth, recording)
        grams = np.array([row.grams[f"as weighed, {belt}"] for row in rows])
        line[f"MAE g, {belt}"] = round(float(np.abs(grams - truth).mean()), 1)
        line[f"held %, {belt}"] = round(100 * float(np.mean([row.held[belt] for row in rows])), 1)
    return line


def _bias_percent(
    grams: NDArray[np.float64], truth_g: NDArray[np.float64], recording: NDArray[np.int64]
) -> tuple[float, float]:
    """(bias, standard error) of the total, percent; recordings are resampled."""
    _, owner = np.unique(recording, return_inverse=True)
    sums, truths = np.bincount(owner, weights=grams), np.bincount(owner, weights=truth_g)
    drawn = np.random.default_rng(0).integers(0, len(sums), (400, len(sums)))
    spread = (sums[drawn].sum(axis=1) / truths[drawn].sum(axis=1)).std()
    return round(100 * float(grams.sum() / truth_g.sum() - 1), 1), round(100 * float(spread), 1)


def markdown(table: list[dict[str, object]], *, seed: int) -> str:
    """The table."""
    columns = [name for name in table[0] if name not in ("preset", "class")]
    head = ["preset", "class", *columns]
    lines = [f"Bias in percent ± standard error; seed {seed}.", "", f"| {' | '.join(head)} |"]
    lines.append("| --- | --- |" + " ---: |" * len(columns))
    for line in table:
        cells = [f"{v[0]:+.1f} ± {v[1]:.1f}" if isinstance(v, tuple) else str(v) for v in line.values()]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)
