"""The router dies, or stands still for longer than any lease: every link is cut, and nothing is missing afterwards."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.chaos.harness import DisturbedLine, canonical, disturbed_replay

pytestmark = [pytest.mark.graph, pytest.mark.timeout(300)]


@pytest.mark.slow
def test_a_killed_router_changes_nothing(recording: Path, run_dir: Path, tmp_path: Path) -> None:
    def disturb(line: DisturbedLine) -> None:
        line.wait_count("tracks_counted", 2)
        line.kill("router")

    summary = disturbed_replay(recording, tmp_path / "run", disturb)
    assert summary["balanced"]
    assert canonical(tmp_path / "run") == canonical(run_dir)


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [2.0, 10.0])
def test_a_router_that_stands_still_changes_nothing(
    recording: Path, run_dir: Path, tmp_path: Path, seconds: float
) -> None:
    """The lease is 2 s: after 10 s every node has lost every other one."""

    def disturb(line: DisturbedLine) -> None:
        line.wait_count("frames_processed", 20)
        line.freeze("router", seconds)

    summary = disturbed_replay(recording, tmp_path / "run", disturb)
    assert summary["balanced"]
    assert all(sheet["frames"]["gaps"] == 0 for sheet in summary["cameras"].values())
    assert canonical(tmp_path / "run") == canonical(run_dir)
