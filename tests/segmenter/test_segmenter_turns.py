"""Tracks of a live line that are due at once take turns: a frame decides few, and no mark passes one that waits."""

from __future__ import annotations

from dataclasses import replace

from segmenter.pipeline import ClosedTrack, Segmenter, Settings
from segmenter.setup import LIVE_DECIDE_M, LIVE_MARK_MARGIN_M
from segmenter.track.tracker import TrackSettings
from tests.segmenter.segmenter_scene import MEDIUM, Body, Scene

LIVE = Settings(
    track=TrackSettings(decide_m=LIVE_DECIDE_M, take_turns=True),
    hold_for_doubtful=False,
    mark_margin_m=LIVE_MARK_MARGIN_M,
)
ALL_AT_ONCE = replace(LIVE, track=replace(LIVE.track, take_turns=False))


def over(
    scene: Scene, settings: Settings, *, frames: int, fps: float = 30.0
) -> tuple[list[list[ClosedTrack]], list[float]]:
    """What each frame closed, and the mark after it."""
    core = Segmenter(settings)
    closed, marks = [], []
    for seq in range(frames):
        closed.append(list(core.step(scene.frame(seq, travel_m=0.014 * seq, fps=fps)).closed))
        marks.append(core.complete_travel_m())
    return [*closed, core.finish()], marks


def row_of(count: int, *, x_m: float) -> list[Body]:
    """Tubers side by side, which cross at once."""
    return [Body(x_m, 0.07 * (n - (count - 1) / 2), a_m=0.030, b_m=0.026, c_m=0.023) for n in range(count)]


def test_tubers_that_cross_at_once_are_decided_one_after_another() -> None:
    scene = Scene(row_of(5, x_m=-0.15), intrinsics=MEDIUM, noise_m=0.0005, seed=5)
    at_once, _ = over(scene, ALL_AT_ONCE, frames=40)
    in_turn, _ = over(scene, LIVE, frames=40)
    first = next(n for n, tracks in enumerate(at_once) if tracks)
    assert max(len(tracks) for tracks in at_once) >= 4
    assert [len(tracks) for tracks in in_turn[first : first + 4]] == [1, 2, 1, 1], (
        "one, and one more for three that wait"
    )
    assert {t.track.track_id for tracks in in_turn for t in tracks} == {
        t.track.track_id for tracks in at_once for t in tracks
    }


def test_where_frames_leave_time_none_waits() -> None:
    scene = Scene(row_of(5, x_m=-0.15), intrinsics=MEDIUM, noise_m=0.0005, seed=5)
    at_once, _ = over(scene, ALL_AT_ONCE, frames=40, fps=15)
    in_time, _ = over(scene, LIVE, frames=40, fps=15)
    assert [len(tracks) for tracks in in_time] == [len(tracks) for tracks in at_once]


def test_no_mark_passes_a_track_that_waits_for_its_turn() -> None:
    """Tubers that cross one shortly after another, so that some wait while marks go on."""
    bodies = [body for n in range(4) for body in row_of(4, x_m=-0.15 - 0.07 * n)]
    closed, marks = over(Scene(bodies, intrinsics=MEDIUM, noise_m=0.0005, seed=5), LIVE, frames=60)
    found = [(n, track.track) for n, tracks in enumerate(closed) for track in tracks]
    assert len(found) == 16
    waited = 0
    for n, track in found:
        assert all(mark < track.travel_m for mark in marks[:n])
        waited += marks[min(n, len(marks) - 1)] < track.travel_m
    assert waited > 0


def test_at_a_camera_s_end_nothing_waits_for_its_turn() -> None:
    scene = Scene(row_of(5, x_m=-0.15), intrinsics=MEDIUM, noise_m=0.0005, seed=5)
    everything, _ = over(scene, LIVE, frames=40)
    first = next(n for n, tracks in enumerate(everything) if tracks)
    cut, _ = over(scene, LIVE, frames=first + 1)
    assert [len(tracks) for tracks in cut if tracks] == [1, 4]
