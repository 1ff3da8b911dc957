"""A replay whose segmenter starts again: what its log has stands."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from segmenter.camera_run import CameraRun
from tests.segmenter.segmenter_scene import Scene
from tests.segmenter.test_segmenter_camera_run import BODIES, FRAMES, SETTINGS, STEP_M, finish, play


def test_a_replay_that_starts_again_takes_back_nothing_that_it_looked_at(tmp_path: Path) -> None:
    scene = Scene(BODIES, noise_m=0.001)
    frames = [scene.frame(i, i * STEP_M) for i in range(FRAMES)]
    settings = replace(SETTINGS, replays=True)
    first = CameraRun("front", "r1", settings, tmp_path / "front.db")
    first.open()
    play(first, frames[:45], names={"a"})
    left = first.log.last_mark
    first.close()
    assert left is not None
    assert left.looked_at_m > 0.3

    second = CameraRun("front", "r1", settings, tmp_path / "front.db")
    second.open()
    again = next(n for n, frame in enumerate(frames) if frame.captured_ns > left.captured_ns)
    play(second, frames[:again], names={"a"}, start_s=5.0)
    assert second.log.last_mark == left, "it says nothing of belt that its log has already"
    play(second, frames[again:], names={"a"}, start_s=6.0)
    went_on = second.log.last_mark
    assert went_on is not None
    assert went_on.looked_at_m > left.looked_at_m
    assert not went_on.final
    finish(second, 9.0, {"a"})
    last = second.log.last_mark
    assert last is not None
    assert last.final
    assert last.looked_at_m == last.travelled_m == pytest.approx((FRAMES - 1) * STEP_M)
    second.close()
