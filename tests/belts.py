"""Recorded belts and the undisturbed run that others are compared with, made once for all workers of a test session."""

from __future__ import annotations

import fcntl
import io
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import redirect_stdout
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


def here(*args: str | Path) -> subprocess.CompletedProcess[str]:
    """The same in this process, which has the modules that a new one would load: where what is told is tested, and not
    how a process starts or ends.
    """
    from tuberline.cli.commands import build_app

    words, out, code = [*map(str, args)], io.StringIO(), 0
    with redirect_stdout(out):
        try:
            build_app()(words)
        except SystemExit as done:
            code = int(done.code or 0)
    return subprocess.CompletedProcess(words, code, out.getvalue(), "")


def replay(recording: Path, out: Path, *options: str) -> dict[str, Any]:
    """`tuberline replay` as a user runs it; its summary."""
    summary: dict[str, Any] = json.loads(tuberline("replay", recording, "--out", out, "--json", *options).stdout)
    return summary


def simulate(out: Path, **options: str) -> Path:
    """`tuberline simulate`, here, with the session's seed, 15 frames/s of 848 x 480."""
    sys.stdout.write(f"seed {SEED} (TUBERLINE_SEED repeats it)\n")
    chosen = {"seed": SEED, "fps": "15", "camera": "d405-848", **options}
    here("simulate", "--out", out, *(part for name, value in chosen.items() for part in (f"--{name}", value)))
    return out


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """The folder `name`, which `make` fills: the worker that asks first does, the others wait. No test writes to it."""
    base = factory.getbasetemp()
    base = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "once"
    base.mkdir(exist_ok=True)
    folder, done = base / name, base / f"{name}.done"
    with (base / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not done.exists():
            shutil.rmtree(folder, ignore_errors=True)
            make(folder)
            done.touch()
    return folder


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two overlapping cameras over one belt, with truth."""
    return made_once(tmp_path_factory, "recording", lambda out: simulate(out, scene="two-cameras", tubers="24"))


@pytest.fixture(scope="session")
def run_dir(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The undisturbed run every other one is compared with: one regressor, and as fast as it goes."""
    return made_once(tmp_path_factory, "run", lambda out: replay(recording, out, "--regressors", "1"))


@pytest.fixture(scope="session")
def live_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One camera over a belt that takes 6 s to pass, with truth."""
    return made_once(tmp_path_factory, "live", lambda out: simulate(out, scene="touching", tubers="80"))


@pytest.fixture(scope="session")
def loaded_recording(live_recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same belt from its first tuber to its last. Two fifths of the other one are empty: there the share of belt
    that was seen says little of the share of tubers that were counted.
    """
    return made_once(tmp_path_factory, "loaded", lambda out: loaded(live_recording, out))


def loaded(live_recording: Path, out: Path) -> None:
    """See `loaded_recording`."""
    shutil.copytree(live_recording, out)
    passed_m = [-tuber["place_x_m"] for tuber in json.loads((out / "truth.json").read_text())["tubers"]]
    table = out / "front" / "frames.csv"
    head, *rows = table.read_text().splitlines()
    kept = [row for row in rows if min(passed_m) - 0.02 <= float(row.split(",")[2]) <= max(passed_m) + 0.02]
    table.write_text("\n".join([head, *kept]) + "\n")
