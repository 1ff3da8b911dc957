"""What an encoder is worth to live cameras, and what its faults cost: the same belts with it, without, and in trouble.

    python -m benchmarks encoder --docs docs/encoder.md

Simulated belts under two cameras that overlap, played as live cameras by real processes; a board sends the count of the
belt's shaft over TCP. Every second belt stops and goes. Seeds of their own that nothing was tuned on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.encoder_line import Act, EncoderLine, cut_power, kill_encoder, lose_count, mute, speak
from benchmarks.figures_in_docs import put_table
from benchmarks.options import above_zero, page_with, parser_of, whole_number
from camera_sim.sim.presets import PRESETS
from camera_sim.sim.record import as_text, write_folder
from camera_sim.sim.scenes import SceneSettings, build_world, in_its_world, layout_named
from camera_sim.sim.source import simulated_sources, truth_of

FIRST_SEED = 9961
PRESET_NAMES = ("easy", "field", "harsh")
TROUBLES: Mapping[str, Sequence[tuple[float, Act]] | None] = {
    "no encoder": None,
    "an encoder": [],
    "silent for a tenth of the belt": [(0.4, mute), (0.5, speak)],
    "lost its count": [(0.5, lose_count)],
    "its process was killed": [(0.5, kill_encoder)],
    "power cut: all but the aggregator": [(0.5, cut_power)],
}
HEAD = (
    "| preset | seed | belt | encoder | true | counted | counted by both | the two apart | belt looked at | told |",
    "| --- | ---: | --- | --- | ---: | ---: | ---: | ---: | ---: | ---: |",
)


def main(arguments: Sequence[str]) -> None:
    """Simulate, play each belt once for each trouble, and print a Markdown table."""
    parser = parser_of("encoder", __doc__)
    parser.add_argument("--belts", type=whole_number(1), default=3)
    parser.add_argument("--tubers", type=whole_number(1), default=240, help="of each belt")
    parser.add_argument(
        "--seed", type=whole_number(0), default=FIRST_SEED, help="of the first belt; the next ones follow"
    )
    parser.add_argument("--speed", type=above_zero, default=0.4, help="times real time, for a slow machine")
    parser.add_argument("--docs", type=page_with("encoder"), help="page between whose marks the table is put")
    given = parser.parse_args(arguments)
    lines = [*HEAD]
    print("\n".join(HEAD))
    for n in range(given.belts):
        preset, profile = PRESET_NAMES[n % len(PRESET_NAMES)], ("runs", "stops and goes")[n % 2]
        with TemporaryDirectory() as folder:
            recording = recorded(Path(folder) / "belt", preset, seed=given.seed + n, tubers=given.tubers, stops=n % 2)
            for k, (name, acts) in enumerate(TROUBLES.items()):
                line = EncoderLine(Path(folder) / str(k), recording, speed=given.speed, encoder=acts is not None)
                line.run(acts or [])
                lines.append(f"| {preset} | {given.seed + n} | {profile} | {name} | {row(line)}")
                print(lines[-1], flush=True)
    if given.docs:
        put_table(given.docs, "encoder", "\n".join(lines))


def recorded(out: Path, preset: str, *, seed: int, tubers: int, stops: bool | int) -> Path:
    """A belt under two cameras that overlap."""
    layout = layout_named("two-cameras")
    if stops:
        layout = replace(layout, profile="stop-and-go")
    settings = in_its_world(SceneSettings("two-cameras", seed, tubers, PRESETS[preset], fps=15.0), layout)
    world = build_world(settings, layout)
    sources = simulated_sources(world, settings, layout)
    write_folder(out, sources, {"truth.json": as_text(truth_of(world, sources))}, lambda done, total: None)
    return out


def row(line: EncoderLine) -> str:
    """What was counted and said; `told`: the share of frames with a travel of the encoder's."""
    tubers, summary, places_m = line.tubers, line.summary, line.places_m
    both = sum(len(tuber.cameras) == 2 for tuber in tubers)
    apart = [abs(found["along_mm"]) for found in summary["totals"].get("apart") or ()]
    cameras = [line.nodes[f"camera/{name}"] for name in line.cameras]
    told, silent = (sum(c.count(f"frames_{how}_travel") for c in cameras) for how in ("with", "without"))
    share = f"{told / (told + silent):.0%}" if told + silent else "-"
    twice = f"{apart[0]:.1f} mm" if apart else "-"
    coverage = "not known" if summary["coverage"] is None else f"{summary['coverage']:.1%}"
    left_out = f" ({left} frames left out)" if (left := line.left_out()) else ""
    return f"{len(places_m)} | {len(tubers)}{left_out} | {both} | {twice} | {coverage} | {share} |"
