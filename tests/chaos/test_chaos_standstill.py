"""Nodes that live and do not move: the supervisor of a replay kills them and starts them again, as systemd does."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from tests.chaos.harness import DisturbedLine, canonical, disturbed_replay
from tuberline import heartbeat

pytestmark = [pytest.mark.graph, pytest.mark.timeout(300)]
STUCK = Path(__file__).parent / "stuck"


@pytest.mark.slow
def test_a_frozen_node_and_one_whose_loop_is_stuck_are_started_again(
    recording: Path, run_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No one saw them: their tokens lived, and the replay waited for them until its limit."""
    monkeypatch.setattr(heartbeat, "STILL_AFTER_S", 8.0)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(STUCK), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep))

    def disturb(line: DisturbedLine) -> None:
        line.wait_count("frames_processed", 6)
        line.signal("segmenter-left", signal.SIGALRM)
        line.signal("aggregator", signal.SIGSTOP)
        line.wait(
            lambda: line.supervisor.restarts["segmenter-left"] and line.supervisor.restarts["aggregator"],
            what="both restarts",
            timeout_s=60,
        )

    summary = disturbed_replay(recording, tmp_path / "run", disturb, speed=0.5)
    assert summary["balanced"]
    assert canonical(tmp_path / "run") == canonical(run_dir)
