"""Live cameras whose clocks step while they run: the belt is looked at as if they had not, and each step is told."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import pytest

from tests.chaos.harness import DisturbedLine, live_run

pytestmark = [pytest.mark.graph, pytest.mark.timeout(300)]
HOUR_NS = 3600 * 10**9
STEPS_NS = (-2 * 10**9, HOUR_NS, -HOUR_NS, -24 * HOUR_NS)
"""A clock set back by 2 s; summer time, and back; a day."""


def with_clock_steps(recording: Path, out: Path) -> Path:
    """A copy of the recording whose camera's clock steps at 1/5, 2/5, 3/5 and 4/5 of it."""
    shutil.copytree(recording, out)
    for table in out.glob("*/frames.csv"):
        with table.open(newline="") as file:
            rows = list(csv.DictReader(file))
        for n, row in enumerate(rows):
            passed = n * (len(STEPS_NS) + 1) // len(rows)
            row["captured_ns"] = str(int(row["captured_ns"]) + sum(STEPS_NS[:passed]))
        with table.open("w", newline="") as file:
            writer = csv.DictWriter(file, rows[0])
            writer.writeheader()
            writer.writerows(rows)
    return out


@pytest.mark.slow
def test_steps_of_a_cameras_clock_cost_no_belt(live_recording: Path, tmp_path: Path) -> None:
    """2 s back made 299 of the next 300 frames too old; an hour back silenced its marks for an hour."""
    recording = with_clock_steps(live_recording, tmp_path / "recording")
    told: list[tuple[int, float, int]] = []

    def watch(line: DisturbedLine) -> None:
        line.wait_count("clock_steps", len(STEPS_NS))
        line.wait_count("tubers_committed", 10)
        told.append((line.count("clock_steps"), line.gauge("clock_offset_s"), line.count("tubers_committed")))

    settings = {"segmenter": {"max_age_ms": 2000.0}}  # this machine's own delays are not the point
    summary = live_run(recording, tmp_path / "run", watch, speed=0.5, settings=settings)
    (sheet,) = summary["cameras"].values()
    frames = sheet["frames"]
    assert told[0][0] == len(STEPS_NS)
    assert told[0][1] == pytest.approx(-sum(STEPS_NS) / 1e9, abs=10.0)
    assert frames.get("dropped_too_old", 0) <= 0.1 * frames["published"]
    assert summary["balanced"]
    assert summary["totals"]["coverage"] > 0.8
