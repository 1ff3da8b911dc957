"""Several cameras without an encoder over belts that stop, and are bare in places: counts, belt seen, and loads.

    python -m benchmarks bare_belts --docs docs/encoder.md

Few tubers on a belt that stops and starts, so that each camera sees none for a while and another one does. Seeds were
fixed before any of these belts was run. Every recording goes through the code of the whole line in one process
(`benchmarks.perception_line`).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from benchmarks.figures_in_docs import put_table
from benchmarks.options import page_with, parser_of, whole_number
from benchmarks.perception_line import LineResult, run_line
from camera_sim.sim.placement import TOUCHING, Packing
from camera_sim.sim.presets import EASY_PRESET, FIELD_PRESET
from camera_sim.sim.record import record_scene
from camera_sim.sim.scenes import Layout, SceneSettings
from regressor.weigh.weigher import Weigher

FIRST_SEED = 7301
SPARSE = Packing(tries=1, touching=0.0, gap_m=0.30, aside_m=0.018)
LAYOUTS = {
    "side by side, 25 cm apart along the belt": Layout(
        SPARSE,
        lanes_m=((-0.15, 0.10), (0.12, 0.66)),
        cameras=(("left", 0.0, -0.33), ("right", 0.25, 0.33)),
        profile="stop-and-go",
    ),
    "three side by side": Layout(
        SPARSE,
        lanes_m=((-1.0, -0.7), (-0.4, 0.0), (0.3, 1.0)),
        cameras=(("a", 0.3, -0.7), ("b", 0.0, 0.0), ("c", 0.15, 0.7)),
        profile="stop-and-go",
    ),
    "one behind the other, 50 cm": Layout(
        SPARSE, lanes_m=((-0.3, 0.3),), cameras=(("a", 0.0, 0.0), ("b", 0.5, 0.0)), profile="stop-and-go"
    ),
    "side by side, the speed changes": Layout(
        SPARSE, lanes_m=((-0.15, 0.6),), cameras=(("left", 0.1, -0.33), ("right", 0.0, 0.33)), profile="changing"
    ),
    "side by side, tubers touch": Layout(
        TOUCHING,
        lanes_m=((-0.68, 0.68),),
        cameras=(("left", 0.0, -0.33), ("right", 0.2, 0.33)),
        profile="stop-and-go",
    ),
}
EASY = SceneSettings("bare", 0, 0, EASY_PRESET, fps=15.0, given_travel=False, belt_distance_m=0.42, speed_mps=0.25)
FIELD = replace(EASY, preset=FIELD_PRESET, belt_distance_m=0.52, speed_mps=0.42)
HEAD = (
    "| cameras | preset | seed | true | counted | belt seen | load as seen | load as estimated |",
    "| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: |",
)


def main(arguments: Sequence[str]) -> None:
    """Simulate, count, weigh and print a Markdown table."""
    parser = parser_of("bare_belts", __doc__)
    parser.add_argument("--tubers", type=whole_number(1), default=24, help="of each belt")
    parser.add_argument(
        "--seed", type=whole_number(0), default=FIRST_SEED, help="of the first belt; the next ones follow"
    )
    parser.add_argument("--out", type=Path, default=Path("out/bare-belts"), help="where recordings are kept")
    parser.add_argument("--docs", type=page_with("bare_belts"), help="page between whose marks the table is put")
    given = parser.parse_args(arguments)
    weigher, rows = Weigher.load(None), []
    print("\n".join(HEAD))
    for n, (name, layout) in enumerate(LAYOUTS.items()):
        for k, kind in enumerate((EASY, FIELD)):
            settings = replace(kind, seed=given.seed + 2 * n + k, tubers=given.tubers)
            recording = given.out / f"seed{settings.seed}-{given.tubers}"
            if not (recording / "truth.json").is_file():  # written last
                record_scene(recording, settings, layout=layout)
            rows.append(_row(name, settings, recording, run_line(recording, weigher)))
            print(rows[-1], flush=True)
    if given.docs:
        put_table(given.docs, "bare_belts", "\n".join([*HEAD, *rows]))


def _row(name: str, settings: SceneSettings, recording: Path, result: LineResult) -> str:
    """One line of the table. Loads in percent of the true one."""
    truth = json.loads((recording / "truth.json").read_text(encoding="utf-8"))["tubers"]
    true_g, totals = sum(tuber["weight_g"] for tuber in truth), result.totals
    seen, estimated = (100 * (grams / true_g - 1) for grams in (totals.weight_g, totals.estimated_weight_g))
    share = "not known" if totals.coverage is None else f"{100 * totals.coverage:.1f} %"
    return (
        f"| {name} | {settings.preset.name} | {settings.seed} | {len(truth)} | {totals.count} | {share} "
        f"| {seen:+.1f} % | {estimated:+.1f} % |"
    )
