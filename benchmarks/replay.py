"""A replay from the command to its last line: as it is and fast in turn, against the recording's real time.

    python -m benchmarks replay [--tubers 1200 --rounds 3] [--peer "PATH/tuberline replay"]

Two cameras that overlap bring 20 tubers a second. `--peer` times another version beside, in the same turns: its command
gets `RECORDING --out DIR --speed max` as well, and its results are judged by this version. The first turn of each is
not counted: it may compile. What a core multiplies is measured before every turn, for that is what a replay lives on.
"""

from __future__ import annotations

import argparse
import os
import resource
import shlex
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import torch

from aggregator.scoring.score import Score, score_run
from benchmarks.line_belt import simulated_belt
from benchmarks.options import parser_of, whole_number
from conveyor.errors import TuberlineError
from conveyor.formats import camera_names, open_source
from conveyor.messages import Frame

OURS = (sys.executable, "-m", "tuberline", "replay")
SIDE = 1024
"""Of the square matrices that tell what a core multiplies."""


@dataclass(slots=True)
class Way:
    """A command to replay by, and what its turns took."""

    name: str
    command: tuple[str, ...]
    wall_s: list[float] = field(default_factory=list)
    cpu_s: list[float] = field(default_factory=list)
    score: Score | None = None

    def turn(self, recording: Path, out: Path, *, counted: bool) -> None:
        """Replay once.

        Raises:
            TuberlineError: the command failed; its last words are in it.
        """
        before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        command = [*self.command, str(recording), "--out", str(out), "--speed", "max"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        wall_s, after = time.perf_counter() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
        if done.returncode:
            raise TuberlineError(f"{shlex.join(command)} ended with {done.returncode}: {done.stderr.strip()[-500:]}")
        self.score = score_run(out, truth=recording / "truth.json")
        if counted:
            self.wall_s.append(wall_s)
            self.cpu_s.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)

    def row(self, real_s: float) -> str:
        """Its row of the table."""
        score = self.score
        assert score is not None
        wall_s = statistics.median(self.wall_s)
        return (
            f"| {self.name} | {', '.join(f'{took_s:.1f}' for took_s in sorted(self.wall_s))} | {real_s / wall_s:.2f} | "
            f"{statistics.median(self.cpu_s):.0f} | {score.count} of {score.true_count} | "
            f"{score.missed}, {score.double_counted}, {score.false} | {score.mae_g:.1f} g | "
            f"{score.weight_error_percent:+.1f} % |"
        )


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print the table."""
    options = _options(arguments)
    torch.set_num_threads(1)
    ways = [
        Way("exact, three views of a track", OURS),
        Way("`--fast`, one view", (*OURS, "--fast")),
    ]
    if options.peer is not None:
        ways.insert(0, Way(f"`{options.peer}`", tuple(shlex.split(options.peer))))
    gflops = []
    with tempfile.TemporaryDirectory() as folder:
        recording = options.recording or Path(folder) / "belt"
        if options.recording is None:
            simulated_belt(
                recording, cameras=2, tubers_per_s=20.0, tubers=options.tubers, fps=15.0, seed=options.seed, load="even"
            )
        real_s = _real_s(recording)
        for turn in range(options.rounds + 1):
            for way in ways:
                gflops.append(_gflops())
                way.turn(recording, Path(folder) / f"{turn}-{ways.index(way)}", counted=turn > 0)
    print(
        "| | whole command s | real time over its median | processor s | counted | missed, twice, false | MAE | load |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    print("\n".join(way.row(real_s) for way in ways))
    print(
        f"\n{real_s:.1f} s of belt, seed {options.seed}; a core multiplies {statistics.median(gflops):.0f} GFLOP/s "
        f"(of {SIDE} wide matrices), {os.cpu_count()} cores, load average {os.getloadavg()[0]:.1f} at the end."
    )
    return 0


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = parser_of("replay", __doc__)
    parser.add_argument("--tubers", type=whole_number(1), default=1200)
    parser.add_argument("--seed", type=whole_number(0), default=12)
    parser.add_argument("--rounds", type=whole_number(1), default=3, help="turns of each that count")
    parser.add_argument("--peer", help='another version\'s command, e.g. "../old/.venv/bin/tuberline replay"')
    parser.add_argument("--recording", type=Path, help="folder recording with its truth.json; default: a simulated one")
    return parser.parse_args(arguments)


def _real_s(recording: Path) -> float:
    """From the first frame to the last, seconds."""
    camera = camera_names(recording)[0]
    times_ns = [
        item.captured_ns for item in open_source(recording, camera=camera).frames(run="time") if isinstance(item, Frame)
    ]
    return (max(times_ns) - min(times_ns)) / 1e9


def _gflops() -> float:
    """Of square matrices on one core, the best of ten."""
    left, right = torch.rand(SIDE, SIDE), torch.rand(SIDE, SIDE)
    took_s = []
    for _ in range(10):
        begun = time.perf_counter()
        left @ right
        took_s.append(time.perf_counter() - begun)
    return float(2 * SIDE**3 / min(took_s) / 1e9)
