"""A segmenter killed while tubers are in view: the replay goes back and the ledger is the same."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.belts import replay, simulate
from tests.chaos.harness import DisturbedLine, canonical, disturbed_replay

pytestmark = [pytest.mark.graph, pytest.mark.timeout(300)]


@pytest.mark.slow
def test_a_killed_segmenter_changes_nothing(recording: Path, run_dir: Path, tmp_path: Path) -> None:
    def disturb(line: DisturbedLine) -> None:
        line.wait_count("tracks_counted", 3)
        name = next(name for name in line.supervisor.restarts if name.startswith("segmenter-"))
        line.kill(name)

    summary = disturbed_replay(recording, tmp_path / "run", disturb)
    assert summary["balanced"]
    assert canonical(tmp_path / "run") == canonical(run_dir)


@pytest.mark.slow
def test_what_a_segmenter_learns_on_the_belt_is_learned_again(tmp_path: Path) -> None:
    """How cloddy the belt is and how high it lies are learned on the way, and decide what is counted and what it
    weighs: a replay starts again from its first frame, so that a killed segmenter learns the same."""
    recording = simulate(tmp_path / "recording", scene="distractors", preset="field", tubers="60")
    replay(recording, tmp_path / "undisturbed")

    def disturb(line: DisturbedLine) -> None:
        line.wait_count("tracks_counted", 20)
        line.kill("segmenter-front")

    summary = disturbed_replay(recording, tmp_path / "run", disturb)
    sheet = summary["cameras"]["front"]["tracks"]
    assert summary["balanced"]
    assert sheet["discarded_distractor"] > 5
    assert canonical(tmp_path / "run") == canonical(tmp_path / "undisturbed")
