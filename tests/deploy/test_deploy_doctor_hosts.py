"""`tuberline doctor` on one host of a line: what stands on another host is no fault of this one."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from conveyor.config import LineConfig, parse_config
from conveyor.messages import Counters
from tuberline.doctor import Finding, Level
from tuberline.doctor.examine import Live, examine
from tuberline.doctor.machine import realsense_mbit


def camera_front(config: LineConfig, *, host: str, alive: bool = True) -> Finding:
    """What is found of it while its node is at work on `host`, or was."""
    nodes = {"camera/front": Counters("camera", "front", "r1", 7, host, "0.2", 3.0, {}, {})}
    live = Live(nodes=nodes, alive=set(nodes) if alive else set())
    (finding,) = [finding for finding in examine(config, live=live) if finding.check == "camera front"]
    return finding


def test_a_recording_that_another_host_plays_need_not_be_here(tmp_path: Path) -> None:
    """On every host for inference `doctor` found a fault of a line that was well, and ended with 1."""
    recording = tmp_path / "belt"
    raw = {"cameras": {"front": {"path": str(recording)}}, "aggregator": {"out": str(tmp_path / "run")}}
    config = parse_config(raw, where="test")
    well = camera_front(config, host="edge")
    assert (well.level, well.text) == (Level.OK, "its node plays a recording on edge, which is not on this host")
    assert camera_front(config, host="edge", alive=False).level is Level.FAULT
    assert camera_front(config, host=socket.gethostname()).level is Level.FAULT
    recording.mkdir()
    assert camera_front(config, host="edge").level is Level.FAULT, "one that is here is looked at"


def test_cameras_that_may_hang_on_another_host_are_no_fault_before_the_line_runs(tmp_path: Path) -> None:
    """On a host for inference `doctor --offline` ended with 1: the line's file names the cameras of all hosts."""
    if realsense_mbit():
        pytest.skip("a RealSense is connected to this machine")
    cameras = {"device": {"source": "realsense", "belt_distance_m": 0.46}, "played": {"path": str(tmp_path / "gone")}}
    for router, level in (("tcp/10.0.0.9:7447", Level.WARNING), ("tcp/127.0.0.1:7447", Level.FAULT)):
        raw = {"link": {"router": router}, "cameras": cameras, "aggregator": {"out": str(tmp_path / "run")}}
        found = examine(parse_config(raw, where="test"), offline=True)
        cameras_found = {finding.check: finding for finding in found if finding.check.startswith("camera ")}
        assert {name: finding.level for name, finding in cameras_found.items()} == {
            "camera device": level,
            "camera played": level,
        }
        assert ("where it hangs on this host: " in cameras_found["camera device"].fix) == (level is Level.WARNING)
