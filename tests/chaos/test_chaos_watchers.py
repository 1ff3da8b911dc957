"""Watching changes nothing: viewer, recorder and `top`, frozen or killed, alter no number and hold no one up."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.chaos.harness import DisturbedLine, canonical, disturbed_replay

pytestmark = [pytest.mark.graph, pytest.mark.timeout(300)]


@contextmanager
def watching(line: DisturbedLine, config: Path, *watchers: tuple[str, ...]) -> Iterator[list[subprocess.Popen[bytes]]]:
    """Commands that watch the line of `config`."""
    processes = [
        subprocess.Popen(
            [sys.executable, "-m", "tuberline", *watcher, "--config", str(config)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        for watcher in watchers
    ]
    try:
        yield processes
    finally:
        for process in processes:
            process.kill()
            process.wait()


def frozen_watchers(recording: Path, out: Path, seconds: float) -> dict[str, object]:
    """A replay whose recorder, `top` and viewer stand still for a while; the first two never come back."""
    rrd = out / "view.rrd" if find_spec("rerun") else None
    recorded = out.parent / "recorded.mcap"

    def disturb(line: DisturbedLine) -> None:
        with watching(line, out / "line.toml", ("recorder", "--out", str(recorded)), ("top",)) as processes:
            if rrd:
                line.wait(lambda: "viewer/viewer" in line.observer.alive(), what="the viewer")
            line.wait_count("frames_processed", 20)
            assert [process.poll() for process in processes] == [None, None], "a watcher gave up at once"
            for process in processes:
                process.send_signal(signal.SIGSTOP)
            done = line.count("frames_processed")
            if rrd:
                line.freeze("viewer", seconds)
                line.kill("viewer")
            else:
                line.go_on(seconds)
            went_on = line.count("frames_processed") > done or line.supervisor.finished("aggregator")
            assert went_on, "frozen watchers held the line up"
            assert line.count("segmenter_stalls") == line.count("stalls") == 0, "a producer waited"

    summary = disturbed_replay(recording, out, disturb, rrd=rrd)
    assert summary["balanced"]
    return summary


@pytest.mark.slow
def test_frozen_and_killed_watchers_change_nothing(recording: Path, run_dir: Path, tmp_path: Path) -> None:
    frozen_watchers(recording, tmp_path / "run", 4.0)
    assert canonical(tmp_path / "run") == canonical(run_dir)


@pytest.mark.slow
def test_watchers_frozen_for_15_s_change_nothing(recording: Path, run_dir: Path, tmp_path: Path) -> None:
    frozen_watchers(recording, tmp_path / "run", 15.0)
    assert canonical(tmp_path / "run") == canonical(run_dir)
