"""An encoder that falls silent and comes back: every tuber once, at the place that the encoder says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from segmenter_scene import Scene, scattered
from test_segmenter_camera_run import RUN_FPS, SETTINGS, entries, finish, play
from test_segmenter_count import STEP_M, assert_each_once, run

from conveyor.messages import Frame
from segmenter.camera_run import CameraRun
from segmenter.track.constants import BELIEVED_BACK_M

BODIES = scattered(33, seed=4)
FRAMES = 120


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    scene = Scene(BODIES, noise_m=0.001)
    return [scene.frame(i, i * STEP_M) for i in range(FRAMES)]


def silent(frames: Sequence[Frame], at: range, *, off_m: float = 0.0) -> list[Frame]:
    """Without an encoder in `at`, and `off_m` elsewhere when it is back."""
    heard = [replace(f, travel_m=None) if f.seq in at else f for f in frames]
    return [
        replace(f, travel_m=f.travel_m + off_m) if f.travel_m is not None and f.seq >= at.stop else f for f in heard
    ]


@pytest.mark.parametrize("at", [range(40, 41), range(40, 70), range(1, 60), range(60, FRAMES)])
def test_the_load_goes_on_where_the_encoder_falls_silent(frames: list[Frame], at: range) -> None:
    """The first frame without it stood still, 13 mm behind the belt, and its tubers opened tracks of their own."""
    core, closed = run(silent(frames, at))
    assert_each_once(closed, BODIES, within_m=0.008)
    assert not core.estimated, "its places count from the encoder's zero all the same"
    assert not any(c.track.travel_estimated for c in closed)
    assert core.travel_m == pytest.approx((FRAMES - 1) * STEP_M, abs=0.02 if at.stop == FRAMES else 1e-9)
    assert core.looked_at_m == core.travelled_m == pytest.approx((FRAMES - 1) * STEP_M, abs=0.02)


@pytest.mark.parametrize("off_m", [0.2, -0.2, 3.0])
def test_what_is_in_view_is_where_an_encoder_from_another_zero_says(frames: list[Frame], off_m: float) -> None:
    """One that starts again knows the belt's place by the load: a little off, or far ahead. No tuber counts twice."""
    core, closed = run(silent(frames, range(50, 60), off_m=off_m))
    assert len(closed) == len(BODIES)
    assert core.told
    assert core.travel_m == pytest.approx((FRAMES - 1) * STEP_M + off_m)
    crossed = np.array([[c.track.crossed_ns / 1e9 * 30 * STEP_M, c.track.y_m] for c in closed])
    truth = np.array([[-b.place_x_m, b.y_m] for b in BODIES])
    gaps = np.hypot(*(truth[:, None] - crossed[None]).transpose(2, 0, 1))
    assert gaps.min(axis=1).max() < 0.015, "each crossed when it crossed"


@pytest.mark.parametrize("at", [range(50, 60), range(50, 50)])
def test_an_encoder_that_lost_its_zero_is_not_believed(frames: list[Frame], at: range) -> None:
    """It would lay tubers over belt that is counted already, where the ledger takes them for the same."""
    core, closed = run(silent(frames, at, off_m=-1.0))
    assert_each_once(closed, BODIES, within_m=0.012)
    assert not core.told
    assert core.encoder_behind_m == pytest.approx(1.0, abs=0.02)
    assert core.encoder_behind_m > BELIEVED_BACK_M


def test_a_run_that_began_without_an_encoder_goes_on_without(frames: list[Frame]) -> None:
    late = [replace(f, travel_m=None if f.seq < 30 else f.travel_m + 7.0) for f in frames if f.travel_m is not None]
    core, closed = run(late)
    assert core.estimated
    assert not core.told
    assert_each_once(closed, BODIES, within_m=0.015, offset_m=0.0)
    assert all(c.track.travel_estimated for c in closed)


@pytest.mark.parametrize("told_again_at", [60, 75])
def test_a_segmenter_that_starts_again_before_its_encoder_counts_nothing_twice(
    frames: list[Frame], tmp_path: Path, told_again_at: int
) -> None:
    """After a power cut: the first frames come without travel, then the encoder goes on where the load has come to."""
    first = CameraRun("front", "r1", SETTINGS, tmp_path / "front.db")
    first.open()
    play(first, frames[:50], names={"a"})
    second = CameraRun("front", "r1", SETTINGS, tmp_path / "front.db")
    second.open()
    play(second, silent(frames, range(50, told_again_at))[56:], names={"a"}, start_s=56 / RUN_FPS)
    finish(second, 9.0, {"a"}, last_seq=FRAMES - 1)
    tracks = [e.track for e in entries(second, 9.0) if e.track is not None]
    mark = second.log.last_mark
    assert mark is not None
    assert not mark.travel_estimated
    assert mark.travel_m == pytest.approx((FRAMES - 1) * STEP_M)
    crossed = np.array([[t.crossed_ns / 1e9 * RUN_FPS * STEP_M, t.y_m] for t in tracks])
    away = np.hypot(*(crossed[:, None] - crossed[None]).transpose(2, 0, 1)) + np.eye(len(crossed))
    assert away.min() > 0.04, "one tuber was logged twice"
    share = mark.looked_at_m / mark.travelled_m
    assert share < 1.0
    assert share == pytest.approx(len(tracks) / len(BODIES), abs=0.12)
