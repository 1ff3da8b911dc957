"""A RealSense that leaves the bus for a moment: the SDK starts it again by itself, and its numbers begin again."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from camera_sim.live.realsense import RealSenseSource
from conveyor.config import CameraConfig
from conveyor.messages import Frame

HERE = Path(__file__).parent / "realsense"
UNIT_M, DISTANCE_M, FPS = 0.0001, 0.46, 30
WITHIN_S = 20.0


@pytest.fixture
def device(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder that commands the SDK's stand-in of this process."""
    monkeypatch.setenv("REALSENSE_STAND_IN", str(tmp_path))
    monkeypatch.syspath_prepend(str(HERE))
    sys.modules.pop("pyrealsense2", None)
    yield tmp_path
    sys.modules.pop("pyrealsense2", None)


def started(source: Any) -> Any:
    """The stand-in's pipeline."""
    return source._pipeline


def test_a_camera_whose_numbers_begin_again_is_opened_again_and_its_frames_go_on(device: Path) -> None:
    """No frame came for as long as the run had lasted, without a word: each was taken for an old one. And in the unit
    that the device then had, if it was another."""
    source = RealSenseSource.connect("front", CameraConfig(source="realsense", belt_distance_m=DISTANCE_M))
    until_s = time.monotonic() + WITHIN_S
    source.attach(lambda _: time.monotonic() < until_s)
    coming = source.frames(run="r1")
    first = next(coming)
    assert isinstance(first, Frame)
    assert first.seq == 0
    started(source)._started -= 100.0  # it has run for so long
    before = [frame.seq for frame in islice(coming, 5) if isinstance(frame, Frame)]
    assert before[0] >= 100 * FPS
    (device / "unit").write_text("0.001")
    (device / "blinks").touch()
    after = [frame for frame in islice(coming, 5) if isinstance(frame, Frame)]
    coming.close()  # type: ignore[attr-defined]
    assert len(after) == 5, f"nothing for {WITHIN_S:.0f} s"
    assert before[-1] < after[0].seq < before[-1] + WITHIN_S * FPS
    assert [frame.seq for frame in after] == sorted({frame.seq for frame in after})
    for frame in after:
        assert frame.depth_scale_m == UNIT_M
        assert np.array_equal(frame.depth, np.full((48, 64), round(DISTANCE_M / UNIT_M)))
    assert source.reopened == 1
    assert "reset" not in (device / "asked").read_text().splitlines()
