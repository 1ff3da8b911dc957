"""Recordings that nothing was tuned on through the code of the whole line, against their truth.

    python -m benchmarks recordings --docs README.md

Recordings and scores are kept under OUT; what is there is not done again, so the command may be stopped and called
again. Nodes and sockets are left out: `tuberline replay` gives the same ledger (`python -m benchmarks perception
--graph` compares the two).
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.figures_in_docs import put_table
from benchmarks.perception_line import run_line
from camera_sim.sim.faults import check_faults
from camera_sim.sim.presets import PRESETS
from camera_sim.sim.record import record_scene
from camera_sim.sim.scenes import SCENES, SceneSettings
from regressor.weigh.weigher import Weigher

HEAD = (
    "| scene, preset, seed | counted of {tubers} | missed, double, false | load off by | MAE, RMSE | place off by |",
    "| --- | --- | --- | --- | --- | --- |",
)


@dataclass(frozen=True, slots=True)
class Belt:
    """One recording: what `tuberline simulate` is given."""

    scene: str
    preset: str
    seed: int
    inject: str = ""

    @property
    def name(self) -> str:
        """Of its folder, and in the table."""
        return "-".join(filter(None, (self.scene, self.preset, str(self.seed), self.inject)))


BELTS = (
    Belt("singulated", "field", 4037),
    Belt("touching", "field", 4037),
    Belt("crowded", "field", 4038),
    Belt("two-cameras", "field", 4037),
    Belt("distractors", "easy", 4031),
    *(Belt("distractors", "field", seed) for seed in range(4032, 4037)),
    Belt("distractors", "field", 4041, "rolling"),
)
"""Half as many clods, stones and leaves as tubers lie on a belt of `distractors`."""


def main(arguments: Sequence[str]) -> None:
    """Simulate, weigh and score each; print a Markdown table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks recordings", description=__doc__)
    parser.add_argument("--tubers", type=int, default=150, help="of each recording")
    parser.add_argument("--only", type=int, nargs="+", help="numbers of recordings, from 0")
    parser.add_argument("--out", type=Path, default=Path("out/recordings"), help="where recordings and runs are kept")
    parser.add_argument("--docs", type=Path, help="page between whose marks the table is put")
    given = parser.parse_args(arguments)
    lines = [line.format(tubers=given.tubers) for line in HEAD]
    weigher, held, models = Weigher.load(None), 0, set()
    belts = [belt for n, belt in enumerate(BELTS) if given.only is None or n in given.only]
    for belt in belts:
        score = scored(belt, given.out, weigher, tubers=given.tubers)
        lines.append(row(belt, score))
        held += score["low_g"] <= score["true_weight_g"] <= score["high_g"]
        models.add(score["model"])
        print(lines[-1], flush=True)
    lines += ["", f"Weighed by {', '.join(sorted(models))}. {held} of {len(belts)} loads lie in their 90 % interval."]
    print("\n".join(lines[-1:]))
    if given.docs:
        put_table(given.docs, "recordings", "\n".join(lines))


def scored(belt: Belt, out: Path, weigher: Weigher, *, tubers: int) -> dict[str, Any]:
    """What `tuberline score --json` would say of the belt, with the `model` that weighed; made where it is missing."""
    recording = out / f"{belt.name}-{tubers}"
    if not (recording / "truth.json").is_file():
        settings = SceneSettings(belt.scene, belt.seed, tubers, PRESETS[belt.preset])
        faults = check_faults((belt.inject,) if belt.inject else ())
        record_scene(recording, settings, layout=SCENES[belt.scene], faults=faults)
    kept = out / f"{belt.name}-{tubers}.json"
    if not kept.is_file():
        line = run_line(recording, weigher)
        told = {"low_g": line.totals.low_g, "high_g": line.totals.high_g, "model": weigher.sidecar.model_id}
        score = line.score(recording / "truth.json").as_dict() | told
        kept.write_text(json.dumps(score, indent=1) + "\n", encoding="utf-8")
    return dict(json.loads(kept.read_text(encoding="utf-8")))


def row(belt: Belt, score: dict[str, Any]) -> str:
    """One row of the table."""
    scene = f"{belt.scene}, {belt.preset}, {belt.seed}" + (f", `--inject {belt.inject}`" if belt.inject else "")
    faults = ", ".join(str(score[name]) for name in ("missed", "double_counted", "false"))
    load = 100 * (score["weight_g"] / score["true_weight_g"] - 1)
    weights = f"{score['mae_g']:.1f}, {score['rmse_g']:.1f} g"
    return f"| {scene} | {score['count']} | {faults} | {load:+.1f} % | {weights} | {score['place_mean_mm']:.1f} mm |"
