"""A live camera's frame numbers go on after those of its run, whenever it learns how far that got."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from conveyor.config import LinkConfig
from tests.camera_sim.camera_process import line, other_side, process
from tests.conftest import wait_until

pytestmark = [pytest.mark.graph, pytest.mark.timeout(120)]
HERE = Path(__file__).parent / "realsense"
RUN_HAD = 5000


def test_a_segmenter_that_is_ready_later_than_its_camera_gets_frames_with_new_numbers(
    link: LinkConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a reboot in mid-run a camera waited a second for its segmenter's word, then numbered from 0. The segmenter,
    which takes longer to start, took all its frames for old ones until the numbers had caught up: the same time again
    as the run had lasted."""
    device = tmp_path / "device"
    device.mkdir()
    monkeypatch.setenv("REALSENSE_STAND_IN", str(device))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(HERE), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep))
    config = line(link, source="realsense", belt_distance_m=0.46)
    with other_side(config) as side, process(config, tmp_path, "camera", "--camera", "front"):
        wait_until(lambda: side.take(0.1) is not None and len(side.seen) >= 10, what="ten frames")
        assert max(side.seen) < RUN_HAD
        side.done(RUN_HAD)
        wait_until(
            lambda: side.take(0.1) is not None and any(seq > RUN_HAD for seq in side.seen),
            what=f"a frame above {RUN_HAD}",
            timeout_s=20,
        )
        new = [seq for seq in side.seen if seq > RUN_HAD]
        assert new[0] == RUN_HAD + 1, "what the numbers skip is no gap"
        side.done(new[0])
        side.take(0.5)
        assert side.seen == sorted(side.seen)
        wait_until(lambda: (c := side.counters()) and c.values.get("numbered_on") == 1, what="its counters")
        counters, info = side.counters(), side.info()
        assert counters is not None
        assert counters.values["frames_missed"] < 30
        assert info is not None
        assert info.last_seq is not None
        assert info.last_seq > RUN_HAD
