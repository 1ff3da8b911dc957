"""Does the belt that is told as seen carry the tubers that were counted, whatever frames were processed?

    python -m benchmarks seen_belt [--runs 48] [--seed 77] [--belt-seed 977] [--out FOLDER]

Stretches of 250 frames of an evenly loaded belt, through one camera's segmenter without processes: frames thinned by
chance, every n-th one, missing in up to three gaps, and the same with the segmenter killed at each gap; with an encoder
and without. Prints by kind how far coverage is off the share of tubers counted, in points, and how often it is told
to be not known.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from random import Random
from statistics import mean, pstdev

from benchmarks.chaos_live_belt import make_belt
from benchmarks.options import parser_of, whole_number
from conveyor.config import parse_config
from conveyor.formats import open_source
from conveyor.messages import Frame, Mark, Track, Weight
from conveyor.messages.tracks import UNFOLLOWED
from segmenter.camera_run import CameraRun, RunSettings
from segmenter.setup import run_settings

KINDS = ("thinned", "every n-th", "gaps", "gaps, killed")
FRAMES = 250


def main(arguments: Sequence[str] | None = None) -> int:
    """Run all and print the table; 1 where more than one of twenty is off by over 5 points."""
    parser = parser_of("seen_belt", __doc__)
    parser.add_argument(
        "--runs", type=whole_number(len(KINDS)), default=48, help="with an encoder, and as many without"
    )
    parser.add_argument("--seed", type=whole_number(0), default=77)
    parser.add_argument("--belt-seed", type=whole_number(0), default=977)
    parser.add_argument("--out", type=Path, help="keep the belt here")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        belt = make_belt("encoder", options.out or Path(folder), seed=options.belt_seed)
        found = {encoder: _all(belt, options, encoder=encoder) for encoder in (True, False)}
    write = sys.stdout.write
    write("| travel by | frames | runs | not known | off by, points: mean | least to most | over 5 |\n")
    write("| --- | --- | --- | --- | --- | --- | --- |\n")
    for encoder, by_kind in found.items():
        for kind, told in by_kind.items():
            off = [each for each in told if each is not None]
            write(
                f"| {'encoder' if encoder else 'the load'} | {kind} | {len(told)} | {told.count(None)} "
                f"| {mean(off):+.1f} (sd {pstdev(off):.1f}) | {min(off):+.1f} to {max(off):+.1f} | {_far(off)} |\n"
            )
    every = [each for by_kind in found.values() for told in by_kind.values() for each in told if each is not None]
    return 0 if _far(every) <= 0.05 * len(every) else 1


def _far(off: Sequence[float]) -> int:
    return sum(abs(each) > 5.0 for each in off)


def _all(belt: Path, options: argparse.Namespace, *, encoder: bool) -> dict[str, list[float | None]]:
    """Points by which coverage is off, by kind; None where it is told to be not known."""
    frames = [frame for frame in open_source(belt, camera="front").frames(run="r") if isinstance(frame, Frame)]
    with (belt / "front" / "frames.csv").open(newline="") as file:
        travel = {int(row["seq"]): float(row["travel_m"]) for row in csv.DictReader(file)}
    passed = [-tuber["place_x_m"] for tuber in json.loads((belt / "truth.json").read_text())["tubers"]]
    camera = {"path": str(belt), "waits": False, "starts_at_s": 1.0}
    settings = run_settings(parse_config({"cameras": {"front": camera}}, where="here"), "front")
    found: dict[str, list[float | None]] = {kind: [] for kind in KINDS}
    for n in range(options.runs):
        kind = KINDS[n % len(KINDS)]
        random = Random(f"{options.seed} {n}")
        first = random.randrange(len(frames) - FRAMES)
        part = frames[first : first + FRAMES]
        shown = part if encoder else [replace(frame, travel_m=None) for frame in part]
        tracks, mark = _run(shown, _pieces(kind, random), replace(settings, log_behind=False))
        here = sum(travel[part[0].seq] < at_m <= travel[part[-1].seq] for at_m in passed)
        off = 100 * (mark.looked_at_m / max(mark.travelled_m, 1e-9) - len(tracks) / here)
        found[kind].append(None if mark.frames.get(UNFOLLOWED) else off)
    return found


def _pieces(kind: str, random: Random) -> list[list[int]]:
    """Numbers of the frames that are processed, by process; the first and the last one always are."""
    if kind == "thinned":
        share = random.choice((0.05, 0.1, 0.15, 0.2, 0.3, 0.5))
        return [sorted({0, FRAMES - 1, *(n for n in range(FRAMES) if random.random() < share)})]
    if kind == "every n-th":
        return [sorted({*range(0, FRAMES, random.randrange(4, 24)), FRAMES - 1})]
    gone: set[int] = set()
    for _ in range(random.choice((1, 2, 3))):
        start = random.randrange(30, 200)
        gone |= set(range(start, min(start + random.randrange(5, 70), FRAMES - 5)))
    pieces: list[list[int]] = [[]]
    for n in range(FRAMES):
        if n in gone and pieces[-1] and "killed" in kind:
            pieces.append([])
        elif n not in gone:
            pieces[-1].append(n)
    return [piece for piece in pieces if piece]


def _run(frames: Sequence[Frame], pieces: Sequence[Sequence[int]], settings: RunSettings) -> tuple[list[Track], Mark]:
    """The tubers that were logged by processes that follow one another, and the last mark."""
    with tempfile.TemporaryDirectory() as folder:
        for piece in pieces:
            run = CameraRun("front", "r", settings, Path(folder) / "front.db")
            run.open()
            for n in piece:
                now_s = frames[n].captured_ns / 1e9
                run.frame(frames[n], now_s)
                _answer(run, now_s)
            if piece is not pieces[-1]:
                run.close()
        run.end(1e9)
        for _ in range(400):
            _answer(run, 1e9)
        run.log.resend()
        tracks = []
        while entries := run.log.due(2e9):
            tracks += [e.track for e in entries if e.track is not None and e.track.kind == "tuber"]
        mark = run.log.last_mark
        run.close()
    assert mark is not None
    return tracks, mark


def _answer(run: CameraRun, now_s: float) -> None:
    """Every view is weighed at once."""
    for name, view in run.tick(now_s, {"r1"}):
        run.weight(
            Weight(
                view_id=view.view_id,
                track_id=view.track_id,
                camera="front",
                run="r",
                seq=view.seq,
                status="weighed",
                weight_g=100.0,
                low_g=90.0,
                high_g=110.0,
                method="pointraft",
                model="m",
                flags=(),
                regressor=name,
            )
        )
