"""Counts and weighs recordings of the other world whose depth was matched: two rendered images, OpenCV's matcher.

    python -m benchmarks matched --docs docs/otherworld.md

Bodies, belts and truth are those of `otherworld_scenes`; the depth is what a stereo matcher makes of two images of them
(`matched_camera`). The table of recordings was written before any of them was run; its seeds stay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from benchmarks.figures_in_docs import put_table
from benchmarks.matched_camera import Matcher
from benchmarks.options import page_with, parser_of, whole_number
from benchmarks.otherworld import chosen, kept, row, table
from benchmarks.otherworld_scenes import Scene
from benchmarks.otherworld_table import MIX, d405, hd, small, vga

SHORT, SMALL_WINDOW, LARGE_WINDOW = Matcher(), Matcher(window_px=9), Matcher(window_px=25)
WIDE = Matcher(baseline_m=0.05)
FAINT = Matcher(contrast=0.08, noise=3.0)
CLOSED = Matcher(semi_global=True, window_px=9)
WHOLE = Matcher(unit_m=0.001)

SCENES: tuple[Scene, ...] = (
    Scene("smooth", 9901, (d405(),), SHORT, "touching", ("smooth",), 40),
    Scene("mixed", 9902, (d405(),), SHORT, "touching", MIX, 40),
    Scene("bumpy", 9903, (d405(height_m=0.45),), SHORT, "touching", ("bumpy", "knobby"), 40, travel=False),
    Scene("long", 9904, (d405(height_m=0.30),), SHORT, "singulated", ("long",), 30, lane_m=0.3, speed_mps=0.5, fps=20),
    Scene("small", 9905, (d405(),), SHORT, "touching", ("small",), 50, lane_m=0.3, speed_mps=0.2, fps=10),
    Scene("small-window", 9906, (d405(height_m=0.40),), SMALL_WINDOW, "touching", ("smooth", "bumpy"), 40),
    Scene("large-window", 9907, (d405(height_m=0.40),), LARGE_WINDOW, "touching", ("smooth", "bumpy"), 40),
    Scene("whole-mm", 9908, (d405(height_m=0.46),), WHOLE, "touching", ("smooth", "long"), 40),
    Scene("large-image", 9909, (hd(),), SHORT, "crowded", MIX, 45, fps=10, speed_mps=0.25),
    Scene("small-image", 9910, (small(),), WIDE, "singulated", ("smooth", "bumpy"), 40, fps=20),
    Scene("wide", 9911, (vga(),), WIDE, "touching", ("smooth", "knobby"), 40),
    Scene("wide-crowded", 9912, (vga(height_m=0.5),), WIDE, "crowded", MIX, 50, travel=False),
    Scene("tilted", 9913, (d405(height_m=0.40, pitch_deg=5, roll_deg=-4),), SHORT, "touching", MIX, 40),
    Scene("faint", 9914, (d405(),), FAINT, "touching", ("smooth", "bumpy"), 40),
    Scene("closed", 9915, (d405(),), CLOSED, "touching", ("smooth", "bumpy"), 40),
    Scene("closed-wide", 9916, (vga(height_m=0.55),), replace(CLOSED, baseline_m=0.05), "touching", MIX, 40),
    Scene("foreign", 9917, (d405(),), SHORT, "touching", ("smooth", "bumpy"), 40, foreign=15),
    Scene("foreign-wide", 9918, (vga(height_m=0.5),), WIDE, "touching", MIX, 40, foreign=15),
)


def main(arguments: Sequence[str]) -> None:
    """Write, count, weigh and print a Markdown table."""
    parser = parser_of("matched", __doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/matched"), help="recordings and results are kept here")
    parser.add_argument("--scenes", nargs="+", metavar="NAME", help="default: all")
    parser.add_argument("--tubers", type=whole_number(1), help="of each recording; default: as planned")
    parser.add_argument(
        "--shift", type=int, default=0, help="added to the planned seeds: other recordings of each kind"
    )
    parser.add_argument(
        "--docs", type=page_with("matched"), nargs="+", default=[], help="pages between whose marks the table is put"
    )
    given = parser.parse_args(arguments)
    rows = []
    for scene in chosen(SCENES, given.scenes, given.tubers, given.shift):
        rows.append(kept(given.out, scene, "line"))
        print(row(rows[-1]), flush=True)
    text = table(rows)
    print(text)
    for page in given.docs:
        put_table(page, "matched", text)
