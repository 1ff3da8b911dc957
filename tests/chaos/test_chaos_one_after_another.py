"""One replay in which camera, aggregator and router are killed in turn, and a regressor ends by an exception.

Each of them alone, and at a moment of its own, is in the other files here (`make chaos`); the segmenter's death, which
sends the replay back to its first frame, stays a test of its own.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.chaos.harness import DisturbedLine, canonical, disturbed_replay, inject

pytestmark = [pytest.mark.graph, pytest.mark.timeout(300)]


def test_everybody_but_the_segmenters_ended_in_turn_changes_nothing(
    recording: Path, run_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A regressor that raised lived on as a zombie: 12 of 102 views were weighed."""
    raised = inject(["regressor regressor.serve.node _Worker._answer 3"], tmp_path, monkeypatch)

    def disturb(line: DisturbedLine) -> None:
        camera = next(name for name in line.supervisor.restarts if name.startswith("camera-"))
        line.wait_count("frames_processed", 20)
        line.kill(camera)
        line.wait(lambda: list(raised.iterdir()), what="a regressor's exception")
        line.wait_applied()
        line.kill("aggregator")
        line.wait_count("tracks_counted", 4)
        line.kill("router")

    # At half speed: all of it falls into the belt's 6 s.
    summary = disturbed_replay(recording, tmp_path / "run", disturb, speed=0.5, regressors=1)
    assert summary["balanced"]
    assert sorted(name.split("-")[0] for name, n in summary["restarts"].items() if n) == [
        "aggregator", "camera", "regressor", "router",
    ]  # fmt: skip
    assert canonical(tmp_path / "run") == canonical(run_dir)
