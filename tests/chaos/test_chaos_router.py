"""The router dies and comes back: every link is cut at once, and nothing is missing afterwards."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.chaos.harness import DisturbedLine, canonical, disturbed_replay

pytestmark = [pytest.mark.graph, pytest.mark.timeout(300)]


def test_a_killed_router_changes_nothing(recording: Path, run_dir: Path, tmp_path: Path) -> None:
    def disturb(line: DisturbedLine) -> None:
        line.wait_count("tracks_counted", 2)
        line.kill("router")

    summary = disturbed_replay(recording, tmp_path / "run", disturb)
    assert summary["balanced"]
    assert canonical(tmp_path / "run") == canonical(run_dir)
