"""An aggregator killed again and again: what it acknowledged is there once, and the ledger ends the same."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.chaos.harness import DisturbedLine, canonical, disturbed_replay

pytestmark = [pytest.mark.graph, pytest.mark.slow, pytest.mark.timeout(300)]


def test_a_killed_aggregator_changes_nothing(recording: Path, run_dir: Path, tmp_path: Path) -> None:
    def disturb(line: DisturbedLine) -> None:
        for _ in range(2):
            line.wait_applied()
            line.kill("aggregator")

    summary = disturbed_replay(recording, tmp_path / "run", disturb, speed=0.3)
    assert summary["balanced"]
    assert summary["restarts"]["aggregator"] >= 2
    assert canonical(tmp_path / "run") == canonical(run_dir)
