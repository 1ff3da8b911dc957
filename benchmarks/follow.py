"""Following the belt where it is seen: what it costs where the belt is stated right, and what it gains where it is not.

    python -m benchmarks follow --docs docs/evaluation-segmentation.md

Each simulated recording is counted and weighed with its belt distance stated right, and stated wrong by a few
millimetres, each once as given and once followed. Seeds of their own that nothing was tuned on.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.figures_in_docs import put_table
from benchmarks.options import chosen, page_with, parser_of, whole_number
from benchmarks.perception_line import run_line
from camera_sim.sim.presets import PRESETS
from camera_sim.sim.record import record_scene
from camera_sim.sim.scenes import SCENES, SceneSettings
from regressor.weigh.weigher import Weigher

FIRST_SEED = 9201
BELTS = (("singulated", "easy"), ("touching", "easy"), ("crowded", "easy"), ("touching", "field"), ("crowded", "field"))
OFF_MM = (0.0, -3.0, 3.0)
"""Stated minus true belt distance."""


@dataclass(frozen=True, slots=True)
class Row:
    """One recording, stated one way: load errors in percent, and how far off the belt was seen, mm."""

    off_mm: float
    given: float
    followed: float
    seen_off_mm: float


def main(arguments: Sequence[str]) -> None:
    """Simulate, count, weigh and print a Markdown table."""
    parser = parser_of("follow", __doc__)
    parser.add_argument("--tubers", type=whole_number(1), default=40, help="of each belt")
    parser.add_argument(
        "--seed", type=whole_number(0), default=FIRST_SEED, help="of the first belt; the next ones follow"
    )
    parser.add_argument("--only", type=whole_number(0), nargs="+", help="numbers of belts, from 0")
    parser.add_argument("--out", type=Path, default=Path("out/follow"), help="where recordings are kept")
    parser.add_argument("--docs", type=page_with("follow"), help="page between whose marks the table is put")
    given = parser.parse_args(arguments)
    weigher, lines, rows = Weigher.load(None), [*HEAD], []
    print("\n".join(HEAD))
    for n, (scene, preset) in chosen(list(enumerate(BELTS)), given.only):
        recording = recorded(given.out, scene, preset, seed=given.seed + n, tubers=given.tubers)
        for off_mm in OFF_MM:
            rows.append(measured(recording, weigher, off_mm))
            lines.append(f"| {scene}, {preset} | {given.seed + n} {_cells([rows[-1]])}")
            print(lines[-1], flush=True)
    lines += [f"| **all, mean** | {_cells([row for row in rows if row.off_mm == off_mm])}" for off_mm in OFF_MM]
    print("\n".join(lines[-len(OFF_MM) :]))
    if given.docs:
        put_table(given.docs, "follow", "\n".join(lines))


HEAD = (
    "| belt | seed | stated off by | seen off what is stated | load, as stated | load, followed |",
    "| --- | ---: | ---: | ---: | ---: | ---: |",
)


def recorded(root: Path, scene: str, preset: str, *, seed: int, tubers: int) -> Path:
    """A recording whose belt is stated right to the micrometre, whatever the preset says of that."""
    out = root / f"follow-{scene}-{preset}-seed{seed}-{tubers}"
    if not (out / "truth.json").is_file():
        known = replace(PRESETS[preset], belt_error_session_m=0.0)
        record_scene(out, SceneSettings(scene, seed, tubers, known, fps=15.0), layout=SCENES[scene])
    return out


def measured(recording: Path, weigher: Weigher, off_mm: float) -> Row:
    """The recording with its belt stated `off_mm` too far, as given and followed."""
    (camera,) = recording.glob("*/camera.json")
    right = camera.read_text(encoding="utf-8")
    values = json.loads(right)
    true_g = sum(tuber["weight_g"] for tuber in json.loads((recording / "truth.json").read_text())["tubers"])
    try:
        camera.write_text(json.dumps(values | {"belt_distance_m": values["belt_distance_m"] + off_mm / 1000}))
        given, followed = (run_line(recording, weigher, belt_follow_mm=mm) for mm in (0.0, None))
    finally:
        camera.write_text(right, encoding="utf-8")
    as_given, as_followed = (100 * (line.totals.estimated_weight_g / true_g - 1) for line in (given, followed))
    return Row(off_mm, as_given, as_followed, seen_off_mm=next(iter(followed.belt_off_mm.values())))


def _cells(rows: list[Row]) -> str:
    mean = [float(np.mean([getattr(row, name) for row in rows])) for name in ("seen_off_mm", "given", "followed")]
    return f"| {rows[0].off_mm:+.0f} mm | {mean[0]:+.1f} mm | {mean[1]:+.1f} % | {mean[2]:+.1f} % |"
