"""From crossing to the mark that lets a tuber be committed, on a virtual clock: what the line's own rules cost, alone.

    python -m benchmarks line_virtual --tubers-per-s 20 --lost 0.01

Dispatcher, weighing, log and marks are the real ones, of one camera; tubers come evenly, regressors take a given time
for a view, and the link to them loses a given share. No machine is measured and every run gives the same figures.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from benchmarks.line_watch import percentile
from benchmarks.options import above_zero, parser_of, whole_number
from conveyor.config import LineConfig
from conveyor.config_camera import CameraConfig
from conveyor.messages import View
from segmenter.camera_run import RunSettings
from segmenter.setup import run_settings
from tests.laws.virtual_overload import FloodedLine, Worker


@dataclass(slots=True)
class LosingWorker(Worker):
    """A regressor behind a link that loses views on the way to it."""

    link: LosingQueue = field(default_factory=lambda: LosingQueue(0.0, 0))

    def __post_init__(self) -> None:
        self.queue = self.link


class LosingQueue(list[View]):
    """A list that loses a share of what is appended."""

    def __init__(self, share: float, seed: int) -> None:
        super().__init__()
        self._share, self._random = share, random.Random(seed)
        self.lost = 0

    def append(self, view: View) -> None:
        """Take a view, or lose it."""
        if self._random.random() < self._share:
            self.lost += 1
        else:
            super().append(view)


def shipped() -> RunSettings:
    """The settings of a live camera as they ship."""
    return run_settings(LineConfig(cameras={"front": CameraConfig(waits=False)}), "front")


def waits_s(line: FloodedLine, *, seconds: float) -> list[float]:
    """For each tuber the seconds from its crossing until a mark in the log says that everything up to it is there."""
    crossed: list[float] = []
    found: list[float] = []
    while line.now_s < seconds:
        tracks = len(line.logged)
        line.turn()
        crossed += [track.crossed_ns / 1e9 for track in line.logged[tracks:]]
        mark = line.run.log.last_mark
        if mark is not None:
            found += [line.now_s - moment for moment in crossed if moment * 1e9 <= mark.complete_ns]
            crossed = [moment for moment in crossed if moment * 1e9 > mark.complete_ns]
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Print one row per setting that is put back to what it was."""
    parser = parser_of("line_virtual", __doc__)
    parser.add_argument("--tubers-per-s", type=above_zero, default=20.0)
    parser.add_argument("--view-ms", type=above_zero, default=12.0, help="what a regressor takes for a view")
    parser.add_argument("--regressors", type=whole_number(1), default=2)
    parser.add_argument("--turn-ms", type=above_zero, default=66.7, help="one frame, and one turn of the segmenter")
    parser.add_argument("--lost", type=float, default=0.01, help="share of views lost on the way")
    parser.add_argument("--seconds", type=above_zero, default=120.0, help="of the virtual clock")
    options = parser.parse_args(arguments)
    live = shipped()
    rows = {
        "as shipped": live,
        "waiting for all three views": replace(live, spare_grace_s=None),
        "marks once a second": replace(live, mark_every_ns=1_000_000_000),
        "three views sent while regressors are busy, too": replace(live, fewer_views=False),
    }
    print("| settings | p50 s | p99 s | views weighed per tuber | requeued |\n| --- | --- | --- | --- | --- |")
    for name, settings in rows.items():
        print(row(name, settings, options))
    return 0


def row(name: str, settings: RunSettings, options: Any) -> str:
    """One line of the table."""
    line = FloodedLine(
        per_s=options.tubers_per_s, takes_s=options.view_ms / 1000, workers=options.regressors,
        turn_s=options.turn_ms / 1000, settings=settings,
    )  # fmt: skip
    line.crew = {
        f"w{n}": LosingWorker(options.view_ms / 1000, link=LosingQueue(options.lost, n))
        for n in range(options.regressors)
    }
    found = waits_s(line, seconds=options.seconds)
    requeued = ", ".join(f"{reason} {n}" for reason, n in sorted(line.run.dispatcher.requeued.items())) or "none"
    weighed = line.run.dispatcher.weighed / max(1, len(line.logged))
    return f"| {name} | {percentile(found, 0.5):.2f} | {percentile(found, 0.99):.2f} | {weighed:.2f} | {requeued} |"
