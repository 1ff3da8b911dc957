"""Recorded belts and the undisturbed run that others are compared with, made once per test session."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

SEED = os.environ.get("TUBERLINE_SEED", "11")


def tuberline(*args: str | Path, check: bool = True, timeout_s: float = 170) -> subprocess.CompletedProcess[str]:
    """Run the command as a user does; the whole output is shown when it fails."""
    done = subprocess.run(
        [sys.executable, "-m", "tuberline", *map(str, args)],
        capture_output=True,
        text=True,
        check=False,
        timeout=timeout_s,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    if check and done.returncode != 0:
        pytest.fail(f"tuberline {args} ended with {done.returncode}:\n{done.stdout}\n{done.stderr}")
    return done


def replay(recording: Path, out: Path, *options: str) -> dict[str, Any]:
    """`tuberline replay` as a user runs it; its summary."""
    summary: dict[str, Any] = json.loads(tuberline("replay", recording, "--out", out, "--json", *options).stdout)
    return summary


def simulate(out: Path, **options: str) -> Path:
    """`tuberline simulate` with the session's seed, 15 frames/s of 848 x 480."""
    sys.stdout.write(f"seed {SEED} (TUBERLINE_SEED repeats it)\n")
    chosen = {"seed": SEED, "fps": "15", "camera": "d405-848", **options}
    tuberline("simulate", "--out", out, *(part for name, value in chosen.items() for part in (f"--{name}", value)))
    return out


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two overlapping cameras over one belt, with truth."""
    return simulate(tmp_path_factory.mktemp("belt") / "recording", scene="two-cameras", tubers="24")


@pytest.fixture(scope="session")
def run_dir(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The undisturbed run every other one is compared with: one regressor, and as fast as it goes."""
    out = tmp_path_factory.mktemp("run") / "out"
    replay(recording, out, "--regressors", "1")
    return out


@pytest.fixture(scope="session")
def live_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One camera over a belt that takes 6 s to pass, with truth."""
    return simulate(tmp_path_factory.mktemp("belt") / "live", scene="touching", tubers="80")


@pytest.fixture(scope="session")
def loaded_recording(live_recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same belt from its first tuber to its last. Two fifths of the other one are empty: there the share of belt
    that was seen says little of the share of tubers that were counted.
    """
    out = tmp_path_factory.mktemp("belt") / "loaded"
    shutil.copytree(live_recording, out)
    passed_m = [-tuber["place_x_m"] for tuber in json.loads((out / "truth.json").read_text())["tubers"]]
    table = out / "front" / "frames.csv"
    head, *rows = table.read_text().splitlines()
    loaded = [row for row in rows if min(passed_m) - 0.02 <= float(row.split(",")[2]) <= max(passed_m) + 0.02]
    table.write_text("\n".join([head, *loaded]) + "\n")
    return out
