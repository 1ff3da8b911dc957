"""A replaying camera killed in the middle goes on where the segmenter is."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.chaos.harness import DisturbedLine, canonical, disturbed_replay

pytestmark = [pytest.mark.graph, pytest.mark.slow, pytest.mark.timeout(300)]


def test_a_killed_camera_changes_nothing(recording: Path, run_dir: Path, tmp_path: Path) -> None:
    def disturb(line: DisturbedLine) -> None:
        line.wait_count("frames_processed", 30)
        name = next(name for name in line.supervisor.restarts if name.startswith("camera-"))
        line.kill(name)

    summary = disturbed_replay(recording, tmp_path / "run", disturb)
    assert summary["balanced"]
    assert canonical(tmp_path / "run") == canonical(run_dir)
