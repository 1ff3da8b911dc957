"""Belts with more than one layer: how many tubers are hidden, what the load weighs, and whether its interval holds.

    python -m benchmarks layers --docs docs/layers.md

Belts of several degrees of piling, and belts in one layer, each with a seed of its own that nothing was tuned on. Every
recording goes through the code of the whole line in one process (`benchmarks.perception_line`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks.figures_in_docs import put_table
from benchmarks.options import chosen, page_with, parser_of, whole_number
from benchmarks.perception_line import LineResult, run_line
from camera_sim.sim.presets import PRESETS
from camera_sim.sim.record import record_scene
from camera_sim.sim.scenes import SCENES, SceneSettings
from conveyor.layers import support_mm_of
from regressor.weigh.weigher import Weigher

FIRST_SEED = 9101
HEAPS = (
    ("crowded", "easy", 0.1),
    ("crowded", "field", 0.2),
    ("crowded", "easy", 0.3),
    ("crowded", "field", 0.3),
    ("crowded", "easy", 0.45),
    ("crowded", "field", 0.45),
    ("crowded", "easy", 0.6),
    ("crowded", "field", 0.6),
    ("touching", "easy", 0.3),
    ("touching", "field", 0.6),
)
"""What lies below, the preset, and the share of the tubers that is dropped onto them."""
SINGLE = (
    ("singulated", "easy"),
    ("touching", "easy"),
    ("crowded", "easy"),
    ("touching", "field"),
    ("crowded", "field"),
    ("crowded", "harsh"),
    ("touching", "harsh"),
)


@dataclass(frozen=True, slots=True)
class Case:
    """One belt: a scene with a share `piled` of the tubers dropped onto the others."""

    scene: str
    preset: str
    piled: float
    seed: int
    tubers: int

    def recording(self, root: Path) -> Path:
        """The recording under `root`, made now where it is not there. Its truth is written last, so it is whole."""
        out = root / f"layers-{self.scene}-{self.preset}-{round(100 * self.piled)}-seed{self.seed}-{self.tubers}"
        if not (out / "truth.json").is_file():
            settings = SceneSettings(self.scene, self.seed, self.tubers, PRESETS[self.preset])
            record_scene(out, settings, layout=replace(SCENES[self.scene], piled=self.piled))
        return out


def cases(tubers: int, first_seed: int = FIRST_SEED) -> list[Case]:
    """All belts, each with its own seed."""
    kinds = [*HEAPS, *((scene, preset, 0.0) for scene, preset in SINGLE)]
    return [Case(*kind, first_seed + n, tubers) for n, kind in enumerate(kinds)]


def main(arguments: Sequence[str]) -> None:
    """Simulate, count, weigh and print a Markdown table."""
    parser = parser_of("layers", __doc__)
    parser.add_argument("--tubers", type=whole_number(1), default=60, help="of each belt")
    parser.add_argument(
        "--seed", type=whole_number(0), default=FIRST_SEED, help="of the first belt; the next ones follow"
    )
    parser.add_argument("--only", type=whole_number(0), nargs="+", help="numbers of belts, from 0")
    parser.add_argument("--out", type=Path, default=Path("out/layers"), help="where recordings are kept")
    parser.add_argument("--docs", type=page_with("layers"), help="page between whose marks the table is put")
    given = parser.parse_args(arguments)
    weigher, lines = Weigher.load(None), []
    print("\n".join(HEAD))
    for case in chosen(cases(given.tubers, given.seed), given.only):
        recording = case.recording(given.out)
        lines.append(row(case, recording, run_line(recording, weigher)))
        print(lines[-1], flush=True)
    text = "\n".join([*HEAD, *lines])
    if given.docs:
        put_table(given.docs, "layers", text)


HEAD = (
    "| belt | seed | true | counted | on others: true, found | hidden: true, estimated | belt with layers "
    "| load as seen | load as estimated | its 90 % interval | holds |",
    "| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | --- |",
)


def row(case: Case, recording: Path, result: LineResult) -> str:
    """One line of the table. Loads in percent of the true one."""
    from json import loads

    truth = loads((recording / "truth.json").read_text(encoding="utf-8"))["tubers"]
    true_g, totals = sum(tuber["weight_g"] for tuber in truth), result.totals
    seen, estimated, low, high = (
        100 * (grams / true_g - 1)
        for grams in (
            totals.weight_g,
            totals.estimated_weight_g,
            totals.estimated_low_g,
            totals.estimated_high_g,
        )
    )
    on_others = sum(tuber.get("layer", 1) > 1 for tuber in truth)
    found = sum(support_mm_of(tuber.flags) > 0 for tuber in result.tubers)
    share = 100 * min(1.0, totals.layered_m / totals.belt_m) if totals.belt_m else 0.0
    kind = f"{case.scene}, {case.preset}" + (f", {100 * case.piled:.0f} % dropped onto them" if case.piled else "")
    return (
        f"| {kind} | {case.seed} | {len(truth)} | {totals.count} | {on_others}, {found} "
        f"| {len(truth) - totals.count}, {totals.hidden:.0f} | {share:.0f} % | {seen:+.1f} % | {estimated:+.1f} % "
        f"| {low:+.1f} to {high:+.1f} % | {'yes' if low <= 0 <= high else '**no**'} |"
    )
