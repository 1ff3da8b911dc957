"""`tuberline run` ends by itself where it was told to, and where nothing is left that could work."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.belts import simulate, tuberline
from tuberline.replayer import free_port

pytestmark = [pytest.mark.graph, pytest.mark.timeout(200)]


def line_file(folder: Path, recording: Path) -> Path:
    file = folder / "line.toml"
    file.write_text(
        f"""
[link]
router = "tcp/127.0.0.1:{free_port()}"
[cameras.front]
path = "{recording}"
speed = 0
[segmenter]
state_dir = "{folder}/state"
[regressor]
processes = 1
state_dir = "{folder}/weights"
[aggregator]
out = "{folder}/run"
exit_when_final = true
"""
    )
    return file


def test_a_line_ends_with_its_load_where_that_is_set(tmp_path: Path) -> None:
    """The aggregator had gone, and everybody else stayed for ever."""
    recording = simulate(tmp_path / "belt", scene="singulated", tubers="4")
    done = tuberline("run", line_file(tmp_path, recording))
    assert done.returncode == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert (summary["final"], summary["state"]) == (True, "ended")
    assert summary["totals"]["count"] == 4


def test_a_line_whose_only_camera_gave_up_ends_with_its_code_and_a_sentence(tmp_path: Path) -> None:
    done = tuberline("run", line_file(tmp_path, tmp_path / "nowhere"), check=False)
    assert done.returncode == 2
    last = done.stderr[done.stderr.rindex("tuberline: ") :]
    assert last.startswith("tuberline: the line is not kept up: camera-front gave up\n")
    assert "nowhere does not exist" in done.stderr
