"""The router dies while the line starts; the supervisor is killed with its whole replay: both come back."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing, suppress
from pathlib import Path

import pytest

from tests.belts import tuberline
from tests.chaos.harness import canonical
from tests.conftest import wait_until
from tests.conveyor.test_conveyor_orphan import descendants

pytestmark = [pytest.mark.graph, pytest.mark.timeout(300)]


def begin(recording: Path, out: Path, *options: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "tuberline", "replay", str(recording), "--out", str(out), "--json", *options]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL)


def child(supervisor: int, role: str) -> int | None:
    """Process id of the supervisor's node that plays a role."""
    for number in descendants(supervisor):
        with suppress(OSError):
            if Path(f"/proc/{number}/cmdline").read_bytes().startswith(f"tuberline {role} ".encode()):
                return number
    return None


def tubers(out: Path) -> int:
    """Tubers in the ledger so far."""
    try:
        with closing(sqlite3.connect(f"file:{out / 'ledger.db'}?mode=ro", uri=True)) as db:
            return int(db.execute("SELECT count(*) FROM tuber").fetchone()[0])
    except sqlite3.Error:
        return 0


def test_a_router_that_dies_while_the_line_starts_changes_nothing(
    recording: Path, run_dir: Path, tmp_path: Path
) -> None:
    """It was never started again: no one looked after it before an observer had connected."""
    out = tmp_path / "run"
    replay = begin(recording, out, "--regressors", "1")
    for after_s in (0.0, 1.0):
        wait_until(lambda: child(replay.pid, "router") is not None, what="a router", timeout_s=30)
        time.sleep(after_s)
        router = child(replay.pid, "router")
        assert router is not None
        os.kill(router, signal.SIGKILL)
        wait_until(lambda gone=router: child(replay.pid, "router") != gone, what="its end", timeout_s=10)  # type: ignore[misc]
    assert replay.wait(150) == 0
    assert canonical(out) == canonical(run_dir)


@pytest.mark.slow
def test_a_replay_killed_with_its_supervisor_goes_on(recording: Path, run_dir: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    replay = begin(recording, out, "--speed", "0.15")
    wait_until(lambda: (out / "ledger.db").exists(), what="the aggregator at work", timeout_s=120)
    busy = tuberline("replay", recording, "--out", out, "--resume", check=False)
    assert busy.returncode == 2
    assert "a router on" in busy.stderr
    wait_until(lambda: tubers(out) >= 3, what="tubers in the ledger", timeout_s=120)
    replay.kill()
    replay.wait()
    before = tubers(out)
    tuberline("replay", recording, "--out", out, "--resume", "--json")
    assert 3 <= before < tubers(out)
    assert canonical(out) == canonical(run_dir)
    began = time.monotonic()
    tuberline("replay", recording, "--out", out, "--resume", "--json")
    assert time.monotonic() - began < 20, "a finished one is only told again"


def test_only_what_was_begun_is_resumed(recording: Path, live_recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    done = tuberline("replay", recording, "--out", out, "--resume", check=False)
    assert (done.returncode, "holds no replay that was begun" in done.stderr) == (2, True)
    out.mkdir()
    (out / "run").write_text("replay-000000000000\n")
    done = tuberline("replay", live_recording, "--out", out, "--resume", check=False)
    assert (done.returncode, "was begun with another recording" in done.stderr) == (2, True)
