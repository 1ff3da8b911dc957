"""The parts of `tuberline replay` that need no processes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from conveyor.config import LineConfig
from conveyor.errors import InputError
from tuberline.cli.replay import parse_speed
from tuberline.processes import line_processes
from tuberline.recorded import lost_frames, none_counted
from tuberline.replayer import fingerprint, prepare_out, replay_config


@pytest.mark.parametrize(("text", "factor"), [("max", 0.0), ("real", 1.0), ("2.5", 2.5)])
def test_speeds(text: str, factor: float) -> None:
    assert parse_speed(text) == factor


@pytest.mark.parametrize("text", ["fast", "0", "-1", "nan", "1e9"])
def test_other_speeds_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="real, max or a factor"):
        parse_speed(text)


def test_a_folder_with_a_ledger_is_refused(tmp_path: Path) -> None:
    (tmp_path / "ledger.db").touch()
    with pytest.raises(InputError, match="already holds a run"):
        prepare_out(tmp_path)


def test_the_fingerprint_is_the_recordings_and_not_the_truths(tmp_path: Path) -> None:
    recording = tmp_path / "rec"
    (recording / "front").mkdir(parents=True)
    (recording / "front" / "frames.csv").write_text("seq,captured_ns,travel_m\n")
    before = fingerprint(recording)
    (recording / "front" / "frames.csv").write_text("seq,captured_ns,travel_n\n")
    assert fingerprint(recording) != before


def test_who_listens_is_started_before_who_speaks(tmp_path: Path) -> None:
    config = replay_config(
        tmp_path, ["a", "b"], out=tmp_path, speed=0, weights=None, regressors=2, rrd=tmp_path / "x.rrd", settings=None
    )
    names = [spec.name for spec in line_processes(config, config_path=tmp_path / "line.toml", run="r")]
    assert names == [
        "router",
        "aggregator",
        "viewer",
        "regressor-r1",
        "regressor-r2",
        "segmenter-a",
        "segmenter-b",
        "camera-a",
        "camera-b",
    ]


def test_further_settings_join_the_defaults(tmp_path: Path) -> None:
    config: LineConfig = replay_config(
        tmp_path,
        ["a"],
        out=tmp_path,
        speed=1,
        weights=None,
        regressors=1,
        rrd=None,
        settings={"segmenter": {"views_per_tuber": 5}},
    )
    assert config.segmenter.views_per_tuber == 5
    assert config.segmenter.state_dir == tmp_path / "state"


def test_frames_that_were_lost_are_told_with_their_number(tmp_path: Path) -> None:
    """Of 210 frames 100 were cut off, and only the log said so."""
    cameras = {
        "left": {"frames": {"published": 210, "processed": 110, "gaps": 100}},
        "right": {"frames": {"published": 210, "processed": 210, "gaps": 0}},
    }
    (told,) = lost_frames(cameras, logs=tmp_path)
    assert "camera 'left': 100 of 210 frames are missing or cannot be read" in told
    assert str(tmp_path / "camera-left.log") in told


def test_frames_that_were_left_out_are_told_with_their_number_and_why(tmp_path: Path) -> None:
    """Over a web that its line had not named 61 of 64 frames showed no belt: 0 tubers, and only the log said why."""
    left = {"published": 64, "processed": 1, "gaps": 0, "dropped_no_belt": 61, "dropped_blind": 2, "dropped_frozen": 0}
    (told,) = lost_frames({"left": {"frames": left}, "right": {"frames": {"published": 3, "gaps": 0}}}, logs=tmp_path)
    assert told.startswith("camera 'left': 63 of 64 frames were left out: 2 blind (too little of the image has depth")
    assert "; 61 no_belt (no belt is seen" in told
    assert str(tmp_path / "segmenter-left.log") in told


def test_why_nothing_counts_is_told() -> None:
    """Of two frames, no tuber crosses between them: 0 tubers and 100 % of the belt seen, and no word."""
    tracks = {"opened": 5, "counted": 0, "open": 0, "discarded_not_crossed": 4, "discarded_flat": 1}
    seen = {"frames": {"processed": 2}, "tracks": tracks, "travelled_m": 0.02}
    never = {"state": "never heard", "frames": {}, "views": {}, "tracks": {}}
    summary: dict[str, Any] = {"state": "ended", "totals": {"count": 0}, "cameras": {"left": seen, "right": never}}
    (told,) = none_counted(summary)
    assert told.startswith("camera 'left': none of 5 tracks counts, in 2 frames over 0.02 m of belt: 1 flat (it is too")
    assert "; 4 not_crossed (it did not reach the centre row before the last frame)" in told
    assert none_counted(summary | {"totals": {"count": 1}}) == []
    assert none_counted(summary | {"state": "nothing seen"}) == []
