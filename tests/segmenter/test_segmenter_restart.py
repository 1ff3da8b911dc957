"""A live segmenter that starts again, mostly without an encoder: what ran on unseen is told, nothing counts twice."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from segmenter_scene import Body, Scene, scattered
from test_segmenter_camera_run import RUN_FPS, SETTINGS, STEP_M, entries, finish, killed_and_back, play

from conveyor.camera_clock import STANDS_AFTER_S
from conveyor.messages import Frame, Mark, Track
from conveyor.messages.tracks import CARRIED, UNFOLLOWED
from segmenter.camera_run import CameraRun
from segmenter.resume import Resume

BODIES = scattered(45, seed=4)
FRAMES = 150


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    scene = Scene(BODIES, noise_m=0.001)
    return [scene.frame(i, i * STEP_M, encoder=False) for i in range(FRAMES)]


def restarted(frames: list[Frame], path: Path, *, killed_after: int, back_at: int) -> tuple[list[Track], Mark]:
    """Everything logged by a process that dies and its successor, and the last mark."""
    first = CameraRun("front", "r1", SETTINGS, path)
    first.open()
    play(first, frames[:killed_after], names={"a"})
    second = CameraRun("front", "r1", SETTINGS, path)
    second.open()
    play(second, frames[back_at:], names={"a"}, start_s=back_at / RUN_FPS)
    finish(second, 9.0, {"a"}, last_seq=frames[-1].seq)
    mark = second.log.last_mark
    assert mark is not None
    return [e.track for e in entries(second, 9.0) if e.track is not None], mark


def test_belt_that_passed_a_dead_process_was_not_looked_at(frames: list[Frame], tmp_path: Path) -> None:
    """What the dead process had seen and not logged, and all that left the view meanwhile, was called looked at."""
    told = [replace(frame, travel_m=frame.seq * STEP_M) for frame in frames]
    log, mark = killed_and_back(told, tmp_path, killed_after=50, back_at=105)
    counted = {t.track_id for e in log if (t := e.track) is not None}
    share = mark.looked_at_m / mark.travelled_m
    assert mark.travelled_m == pytest.approx((FRAMES - 1) * STEP_M)
    assert len(counted) < 40
    assert share == pytest.approx(len(counted) / len(BODIES), abs=0.1)


@pytest.mark.parametrize(("killed_after", "back_at"), [(50, 53), (50, 62), (50, 105)])
def test_belt_that_ran_on_without_an_encoder_lowers_the_coverage(
    frames: list[Frame], tmp_path: Path, killed_after: int, back_at: int
) -> None:
    """The travel stood still in the gap, so that coverage said 100 % of a belt of which a third had gone by unseen."""
    tracks, mark = restarted(frames, tmp_path / "front.db", killed_after=killed_after, back_at=back_at)
    assert mark.travel_estimated
    assert mark.travelled_m == pytest.approx((FRAMES - 1) * STEP_M, rel=0.03)
    gap_ms = 1000 * (back_at - killed_after) / RUN_FPS
    assert gap_ms <= mark.frames[CARRIED] <= gap_ms + 300, "no load was seen to move, but for the belt's bare beginning"
    share = mark.looked_at_m / mark.travelled_m
    assert share < 1.0
    assert len(tracks) <= len(BODIES)
    assert share == pytest.approx(len(tracks) / len(BODIES), abs=0.12)
    crossed = np.array([[t.crossed_ns / 1e9 * RUN_FPS * STEP_M, t.y_m] for t in tracks])
    away = np.hypot(*(crossed[:, None] - crossed[None]).transpose(2, 0, 1)) + np.eye(len(crossed))
    assert away.min() > 0.04, "one tuber was logged twice"


@pytest.mark.parametrize("killed_after", [2, 5])
def test_belt_that_passes_before_any_speed_is_known_is_told_once_there_is_one(
    frames: list[Frame], tmp_path: Path, killed_after: int
) -> None:
    """A segmenter that died within its first frames knew no speed: what passed until it was back was missing."""
    tracks, mark = restarted(frames, tmp_path / "front.db", killed_after=killed_after, back_at=60)
    assert mark.travelled_m == pytest.approx((FRAMES - 1) * STEP_M, rel=0.05)
    assert mark.looked_at_m / mark.travelled_m == pytest.approx(len(tracks) / len(BODIES), abs=0.12)
    assert UNFOLLOWED not in mark.frames
    assert mark.frames[CARRIED] >= 1000 * (60 - killed_after) / RUN_FPS


def test_a_belt_of_which_no_two_frames_share_any_says_so(tmp_path: Path) -> None:
    """Its coverage was told from the little that was known of it: 50 points too much."""
    rng = np.random.default_rng(0)
    places = zip(rng.uniform(-0.2, 3.6, 30), rng.uniform(-0.2, 0.2, 30), strict=True)
    scene = Scene([Body(-float(x_m), float(y_m)) for x_m, y_m in places], noise_m=0.001)
    apart = [scene.frame(i, i * STEP_M, encoder=False) for i in range(0, 240, 48)]  # 0.64 m; 0.51 m are in view
    for part in (apart[:3], apart[3:]):  # the second process knows as little
        it = CameraRun("front", "r1", SETTINGS, tmp_path / "front.db")
        it.open()
        play(it, part, names={"a"})
    finish(it, 9.0, {"a"}, last_seq=apart[-1].seq)
    mark = it.log.last_mark
    assert mark is not None
    assert mark.travelled_m == 0.0
    assert mark.frames[UNFOLLOWED] == 1000 * apart[-1].seq // RUN_FPS
    assert mark.frames[CARRIED] == mark.frames[UNFOLLOWED]


@pytest.mark.parametrize("missing", [12, 55, 90])
def test_belt_that_passes_a_segmenter_that_stood_still_is_told(
    frames: list[Frame], tmp_path: Path, missing: int
) -> None:
    """After 10 s without a frame the travel stood still: 12 s of a belt were in no coverage (90 % for 72 % counted)."""
    slow = [replace(f, captured_ns=f.captured_ns * 4) for f in frames]  # 90 frames are 12 s
    it = CameraRun("front", "r1", SETTINGS, tmp_path / "front.db")
    it.open()
    play(it, [*slow[:40], *slow[40 + missing :]], names={"a"})
    finish(it, 9.0, {"a"}, last_seq=frames[-1].seq)
    mark = it.log.last_mark
    assert mark is not None
    assert mark.travelled_m == pytest.approx((FRAMES - 1) * STEP_M, rel=0.03)
    tracks = [e.track for e in entries(it, 9.0) if e.track is not None]
    assert mark.looked_at_m / mark.travelled_m == pytest.approx(len(tracks) / len(BODIES), abs=0.12)


@pytest.mark.parametrize("names", [{"a"}, set()], ids=["weighed", "no-regressor"])
def test_a_segmenter_that_comes_back_after_its_camera_had_ended_keeps_what_was_known(
    frames: list[Frame], tmp_path: Path, names: set[str]
) -> None:
    """Its final mark had the time 0 and no estimated travel: the belt's speed was forgotten (83 % for 55 % counted).

    And belt whose tubers had died with the first process, waiting for their weights, was told as looked at.
    """
    first = CameraRun("front", "r1", SETTINGS, tmp_path / "front.db")
    first.open()
    play(first, frames[:90], names=names)
    left = first.log.last_mark
    assert left is not None
    second = CameraRun("front", "r1", SETTINGS, tmp_path / "front.db")
    second.open()
    second.end(9.0)
    second.tick(9.1, {"a"})
    mark = second.log.last_mark
    assert mark is not None
    assert mark.final
    assert (mark.captured_ns, mark.travel_estimated) == (left.captured_ns, True)
    assert (mark.travel_m, mark.travelled_m) == (left.travel_m, left.travelled_m)
    logged, lost = mark.tracks["counted"], mark.tracks.get("discarded_restart", 0)
    assert (logged > 0) == bool(names)
    assert mark.looked_at_m == pytest.approx(left.looked_at_m * logged / (logged + lost))


def test_a_belt_that_stood_while_nobody_looked_has_not_moved(frames: list[Frame], tmp_path: Path) -> None:
    late = [replace(f, captured_ns=f.captured_ns + (30 * 10**9 if f.seq >= 60 else 0)) for f in frames]
    it = CameraRun("front", "r1", SETTINGS, tmp_path / "front.db")
    it.open()
    play(it, late, names={"a"})
    finish(it, 9.0, {"a"}, last_seq=frames[-1].seq)
    mark = it.log.last_mark
    assert mark is not None
    assert mark.travelled_m == pytest.approx((FRAMES - 1) * STEP_M, rel=0.03)
    assert mark.looked_at_m == mark.travelled_m


def test_the_last_speed_survives_that_everything_is_committed(frames: list[Frame], tmp_path: Path) -> None:
    path = tmp_path / "front.db"
    first = CameraRun("front", "r1", SETTINGS, path)
    first.open()
    play(first, frames[:70], names={"a"})
    told = first.log.speed_mps
    first.log.commit(first.log.newest)
    second = CameraRun("front", "r1", SETTINGS, path)
    second.open()
    assert second.log.uncommitted == 0
    assert second.log.speed_mps == told == pytest.approx(STEP_M * RUN_FPS, rel=0.1)


def test_a_clock_that_says_nothing_and_a_line_that_was_down_move_the_belt_by_no_more_than_is_sure() -> None:
    left = Resume(10**9, -1.0, 1.1, 1.0, 1.1, captured_ns=2 * 10**9, speed_mps=0.5)
    assert left.brought_to(10**9) is left
    assert left.brought_to(4 * 10**9).travel_m == pytest.approx(2.1)
    assert left.brought_to(4 * 10**9).looked_at_m == left.looked_at_m
    assert left.brought_to(10**15).travel_m == pytest.approx(1.1 + 0.5 * STANDS_AFTER_S)
