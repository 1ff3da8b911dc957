"""Watching changes nothing: a viewer frozen for most of the run alters no number and holds nobody up."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from tests.chaos.harness import DisturbedLine, canonical, disturbed_replay

pytestmark = [pytest.mark.graph, pytest.mark.timeout(300)]
pytest.importorskip("rerun", reason="needs the viewer extra")


def test_a_frozen_viewer_changes_nothing(recording: Path, run_dir: Path, tmp_path: Path) -> None:
    def disturb(line: DisturbedLine) -> None:
        line.wait(lambda: "viewer/viewer" in line.observer.alive(), what="the viewer")
        line.signal("viewer", signal.SIGSTOP)

    summary = disturbed_replay(recording, tmp_path / "run", disturb, rrd=tmp_path / "view.rrd")
    assert summary["balanced"]
    assert canonical(tmp_path / "run") == canonical(run_dir)
