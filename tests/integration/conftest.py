"""A recorded belt for the whole graph, simulated once per test session."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

SEED = os.environ.get("TUBERLINE_SEED", "11")


def tuberline(*args: str | Path, check: bool = True, timeout_s: float = 170) -> subprocess.CompletedProcess[str]:
    """Run the command as a user does; the whole output is shown when it fails."""
    done = subprocess.run(
        [sys.executable, "-m", "conveyor", *map(str, args)],
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


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two overlapping cameras over one belt, with truth."""
    folder = tmp_path_factory.mktemp("belt") / "recording"
    sys.stdout.write(f"seed {SEED} (TUBERLINE_SEED repeats it)\n")
    tuberline(
        "simulate",
        "--out",
        folder,
        "--seed",
        SEED,
        "--scene",
        "two-cameras",
        "--tubers",
        "24",
        "--fps",
        "15",
        "--camera",
        "d405-848",
    )
    return folder


@pytest.fixture(scope="session")
def run_dir(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The undisturbed run every other one is compared with."""
    out = tmp_path_factory.mktemp("run") / "out"
    replay(recording, out)
    return out
