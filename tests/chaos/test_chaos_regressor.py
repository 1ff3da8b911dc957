"""A regressor killed in the middle of its work, and one frozen and resumed: no tuber is lost and none weighed twice."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.chaos.harness import DisturbedLine, canonical, disturbed_replay

pytestmark = [pytest.mark.graph, pytest.mark.slow, pytest.mark.timeout(300)]


def test_a_killed_regressor_changes_nothing(recording: Path, run_dir: Path, tmp_path: Path) -> None:
    def disturb(line: DisturbedLine) -> None:
        line.wait_count("views_sent", 3)
        line.kill("regressor-r1")

    summary = disturbed_replay(recording, tmp_path / "run", disturb)
    assert summary["balanced"]
    assert summary["restarts"]["regressor-r1"] >= 1
    assert canonical(tmp_path / "run") == canonical(run_dir)


def test_a_frozen_regressor_comes_back_with_answers_nobody_needs(
    recording: Path, run_dir: Path, tmp_path: Path
) -> None:
    def disturb(line: DisturbedLine) -> None:
        line.wait_count("views_sent", 3)
        line.freeze("regressor-r1", 4.0)

    summary = disturbed_replay(recording, tmp_path / "run", disturb, settings={"segmenter": {"job_deadline_s": 1.0}})
    assert summary["balanced"]
    assert canonical(tmp_path / "run") == canonical(run_dir)
