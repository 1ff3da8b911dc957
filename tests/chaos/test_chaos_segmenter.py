"""A segmenter killed while tubers are in view: the replay goes back and the ledger is the same."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.chaos.harness import DisturbedLine, canonical, disturbed_replay

pytestmark = [pytest.mark.graph, pytest.mark.timeout(300)]


def test_a_killed_segmenter_changes_nothing(recording: Path, run_dir: Path, tmp_path: Path) -> None:
    def disturb(line: DisturbedLine) -> None:
        line.wait_count("tracks_counted", 3)
        name = next(name for name in line.supervisor.restarts if name.startswith("segmenter-"))
        line.kill(name)

    summary = disturbed_replay(recording, tmp_path / "run", disturb)
    assert summary["balanced"]
    assert canonical(tmp_path / "run") == canonical(run_dir)
