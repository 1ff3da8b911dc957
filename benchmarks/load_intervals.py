"""How often a load's interval, as the ledger states it before any ticket, holds the truth; by preset, over recordings.

    python -m benchmarks load_intervals --docs docs/worlds.md

Each recording is a world of its own: camera, belt, cultivar and what its user states. It goes through the code of the
whole line in one process (`benchmarks.perception_line`).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.figures_in_docs import put_table
from benchmarks.options import page_with, parser_of, whole_number
from benchmarks.perception_line import run_line
from camera_sim.sim.presets import PRESETS
from camera_sim.sim.record import record_scene
from camera_sim.sim.scenes import SCENES, SceneSettings
from conveyor.statistics import NORMAL_90
from regressor.weigh.weigher import Weigher

FIRST_SEEDS = {"easy": 9601, "field": 9621, "harsh": 9641, "exact": 9661, "matched": 9681}
SCENE = "touching"


@dataclass(frozen=True, slots=True)
class Load:
    """One recording: errors and bounds in percent of its true weight."""

    error: float
    low: float
    high: float
    counted: float
    parts: dict[str, float]

    @property
    def held(self) -> bool:
        """The true weight lies in the interval."""
        return self.low <= 0.0 <= self.high


def main(arguments: Sequence[str]) -> None:
    """Simulate, count, weigh and print a Markdown table."""
    parser = parser_of("load_intervals", __doc__)
    parser.add_argument("--presets", nargs="+", choices=tuple(FIRST_SEEDS), default=list(FIRST_SEEDS))
    parser.add_argument("--recordings", type=whole_number(1), default=20, help="of each preset")
    parser.add_argument("--tubers", type=whole_number(1), default=40, help="of each recording")
    parser.add_argument("--seed", type=whole_number(0), help="of the first recording; default: by preset")
    parser.add_argument(
        "--docs",
        type=page_with("load_intervals"),
        nargs="+",
        default=[],
        help="pages between whose marks the table is put",
    )
    given = parser.parse_args(arguments)
    weigher, lines = Weigher.load(None), [*HEAD]
    for preset in given.presets:
        first = FIRST_SEEDS[preset] if given.seed is None else given.seed
        loads = []
        for seed in range(first, first + given.recordings):
            loads.append(measured(preset, seed, given.tubers, weigher))
            print(f"{preset} {seed}: {loads[-1]}", flush=True)
        lines.append(row(preset, first, loads))
    text = "\n".join(lines)
    print(text)
    for page in given.docs:
        put_table(page, "load_intervals", text)


def measured(preset: str, seed: int, tubers: int, weigher: Weigher) -> Load:
    """One recording, made, counted, weighed and thrown away."""
    from tempfile import TemporaryDirectory

    with TemporaryDirectory() as folder:
        recording = Path(folder) / "recording"
        record_scene(recording, SceneSettings(SCENE, seed, tubers, PRESETS[preset], fps=15.0), layout=SCENES[SCENE])
        truth = json.loads((recording / "truth.json").read_text(encoding="utf-8"))["tubers"]
        totals = run_line(recording, weigher).totals
    true_g = sum(tuber["weight_g"] for tuber in truth)
    error, low, high = (
        100 * (grams / true_g - 1)
        for grams in (totals.estimated_weight_g, totals.estimated_low_g, totals.estimated_high_g)
    )
    return Load(error, low, high, totals.count / len(truth), dict(totals.parts_percent))


HEAD = (
    "| preset | recordings, first seed | count | load, mean | load, sd | half of the interval | holds |",
    "| --- | ---: | ---: | ---: | ---: | ---: | ---: |",
)


def row(preset: str, first: int, loads: Sequence[Load]) -> str:
    """One line of the table, with the 90 % interval of the share that holds."""
    errors = np.array([load.error for load in loads])
    half = float(np.mean([(load.high - load.low) / 2 for load in loads]))
    held, n = sum(load.held for load in loads), len(loads)
    low, high = _wilson(held, n)
    return (
        f"| {preset} | {n}, {first} | {100 * np.mean([load.counted for load in loads]):.1f} % | {errors.mean():+.1f} % "
        f"| {errors.std():.1f} % | {half:.1f} % | {held} of {n} ({100 * low:.0f} to {100 * high:.0f} %) |"
    )


def _wilson(held: int, n: int) -> tuple[float, float]:
    z2 = NORMAL_90**2
    middle = (held + z2 / 2) / (n + z2)
    half = NORMAL_90 * float(np.sqrt(held * (n - held) / n + z2 / 4)) / (n + z2)
    return max(0.0, middle - half), min(1.0, middle + half)
