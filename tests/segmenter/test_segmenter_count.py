"""Counting on analytic scenes: every tuber once, at its place, whatever happens to the frames."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from segmenter_scene import SMALL, Body, Scene, scattered, tilted

from conveyor.belt_findings import belt_findings
from conveyor.messages import Frame
from conveyor.reasons import FrameDrop
from segmenter.pipeline import ClosedTrack, Segmenter, Settings
from segmenter.track.coverage import Coverage

STEP_M = 0.0133


def run(frames: Iterable[Frame]) -> tuple[Segmenter, list[ClosedTrack]]:
    core, closed = Segmenter(Settings()), []
    for frame in frames:
        closed += core.step(frame).closed
    return core, closed + core.finish()


def assert_each_once(closed: list[ClosedTrack], bodies: list[Body], *, within_m: float, offset_m: float = 0.0) -> None:
    places = np.array([[c.track.place_x_m - offset_m, c.track.y_m] for c in closed])
    truth = np.array([[b.place_x_m, b.y_m] for b in bodies])
    assert len(places) == len(truth)
    gaps = np.hypot(*(truth[:, None] - places[None]).transpose(2, 0, 1))
    assert gaps.min(axis=1).max() < within_m
    assert len(set(gaps.argmin(axis=1).tolist())) == len(truth)


def test_every_tuber_once_at_its_place_with_three_views() -> None:
    bodies = scattered(15, seed=1)
    scene = Scene(bodies, noise_m=0.001, holes=0.02)
    core, closed = run(scene.frame(i, i * STEP_M) for i in range(70))
    assert_each_once(closed, bodies, within_m=0.002)
    for c in closed:
        assert [v.rank for v in c.views] == [0, 1, 2]
        assert len({v.view_id for v in c.views}) == 3
        assert c.track.crossed_ns == pytest.approx(c.track.travel_m / STEP_M / 30 * 1e9, abs=2e6)
        body = min(bodies, key=lambda b: np.hypot(c.track.place_x_m - b.place_x_m, c.track.y_m - b.y_m))
        assert c.track.length_mm == pytest.approx(2000 * body.a_m, abs=6)
        assert c.track.height_mm == pytest.approx(2000 * body.c_m, abs=3)
    counts = core.track_counts()
    assert counts["opened"] == sum(n for name, n in counts.items() if name != "opened")
    assert core.looked_at_m == core.travelled_m == pytest.approx(69 * STEP_M)


def test_views_are_the_tubers_own_depth_pixels_and_rank_0_is_nearest_the_row() -> None:
    scene = Scene([Body(-0.3, 0.02)])
    _, closed = run(scene.frame(i, i * STEP_M) for i in range(50))
    (only,) = closed
    for view in only.views:
        depth, labels = scene.render(view.seq * STEP_M)
        rows, columns = slice(view.v0, view.v0 + view.depth.shape[0]), slice(view.u0, view.u0 + view.depth.shape[1])
        inside = view.depth > 0
        assert (view.depth[inside] == depth[rows, columns][inside]).all()
        assert inside.sum() > 0.97 * (labels == 1).sum()
        assert (labels[rows, columns][inside] == 1).mean() > 0.97
    offsets = [abs(view.seq * STEP_M - 0.3) for view in only.views]
    assert offsets[0] == min(offsets)


def test_the_same_frames_give_the_same_tracks_and_views_bit_for_bit() -> None:
    scene = Scene(scattered(9, seed=2), noise_m=0.001, holes=0.02)
    frames = [scene.frame(i, i * STEP_M, encoder=False) for i in range(45)]
    (_, first), (_, second) = run(frames), run(frames)
    assert [c.track for c in first] == [c.track for c in second]
    assert [v.encode() for c in first for v in c.views] == [v.encode() for c in second for v in c.views]


@pytest.mark.parametrize("drop", ["every other", "a fifth", "bursts"])
def test_dropped_frames_change_no_count(drop: str) -> None:
    bodies = scattered(15, seed=5)
    scene = Scene(bodies, noise_m=0.001)
    rng = np.random.default_rng(11)
    lost = {
        "every other": lambda i: i % 2 == 1,
        "a fifth": lambda i: bool(rng.random() < 0.2),
        "bursts": lambda i: 20 <= i < 27 or 40 <= i < 48,
    }[drop]
    core, closed = run(scene.frame(i, i * STEP_M) for i in range(72) if not lost(i))
    assert_each_once(closed, bodies, within_m=0.003)
    assert core.looked_at_m == pytest.approx(core.travelled_m)


def test_a_gap_longer_than_the_view_is_belt_not_looked_at() -> None:
    scene = Scene([Body(-0.1, 0.0), Body(-2.0, 0.0)])
    core, closed = run(scene.frame(i, t) for i, t in enumerate([0.0, 0.05, 0.1, 0.15, 1.5, 1.9, 1.95, 2.0, 2.05, 2.1]))
    assert len(closed) == 2
    view_m = 240 * 0.46 / 216.5
    unseen_m = (1.35 - (view_m - 0.12)) + max(0.0, 0.4 - (view_m - 0.12))
    assert core.travelled_m - core.looked_at_m == pytest.approx(unseen_m, abs=0.001)


def test_stop_and_go_and_a_little_backwards_count_nothing_twice() -> None:
    bodies = scattered(9, seed=6)
    scene = Scene(bodies, noise_m=0.001)
    moves = [STEP_M] * 12 + [0.0] * 15 + [-0.002] * 4 + [0.004] * 10 + [STEP_M] * 32
    travels = np.concatenate([[0.0], np.cumsum(moves)])
    _, closed = run(scene.frame(i, float(t)) for i, t in enumerate(travels))
    assert_each_once(closed, [b for b in bodies if -travels[-1] < b.place_x_m], within_m=0.002)


def test_first_and_last_frame_bound_what_counts() -> None:
    before, crossed, last, after = Body(0.004, -0.12), Body(-0.004, -0.02), Body(-0.396, 0.08), Body(-0.404, -0.1)
    scene = Scene([before, crossed, last, after])
    _, closed = run(scene.frame(i, i * 0.02) for i in range(21))
    assert_each_once(closed, [crossed, last], within_m=0.001)


def test_a_tuber_that_crosses_while_no_frame_comes_still_counts() -> None:
    body = Body(-0.2, 0.03)
    scene = Scene([body])
    travels = [0.0, 0.02, 0.04, 0.06, 0.36, 0.38, 0.6]
    _, closed = run(scene.frame(i, t) for i, t in enumerate(travels))
    assert_each_once(closed, [body], within_m=0.001)
    assert closed[0].track.crossed_ns == pytest.approx((3 + (0.2 - 0.06) / 0.3) / 30 * 1e9, abs=2e6)


@pytest.mark.parametrize("tilt", [0.0, 7.0])
def test_travel_is_estimated_within_half_a_percent_through_stops_and_speed_changes(tilt: float) -> None:
    bodies = scattered(36, seed=9)
    scene = Scene(bodies, SMALL, tilted(0.46, tilt), noise_m=0.001)
    moves = [0.012] * 40 + [0.0] * 10 + [0.006] * 30 + [0.02] * 40
    travels = np.concatenate([[0.0], np.cumsum(moves)])
    core, closed = run(scene.frame(i, float(t), encoder=False) for i, t in enumerate(travels))
    assert core.travel_m == pytest.approx(travels[-1], rel=0.005)
    assert all(c.track.travel_estimated for c in closed)
    assert_each_once(closed, [b for b in bodies if -travels[-1] + 0.01 < b.place_x_m], within_m=0.010)


@pytest.mark.parametrize(("apart", "told"), [(2, False), (8, True)])
def test_pictures_out_of_order_cost_coverage_and_are_told(apart: int, told: bool) -> None:
    """Two pictures in each other's place tore the travel that the load tells: none of 8 tubers, and 100 % looked at."""
    scene = Scene(scattered(15, seed=1), noise_m=0.001)
    frames = [scene.frame(i, i * STEP_M, encoder=False) for i in range(70)]
    one, other = 20, 20 + apart
    frames[one], frames[other] = (
        replace(frames[i], depth=frames[j].depth) for i, j in ((one, other), (other, one))
    )  # fmt: skip
    core, closed = run(frames)
    seen = core.looked_at_m / core.travelled_m
    if not told:
        assert (core.torn_m, seen, len(closed)) == (0.0, 1.0, 15)
        return
    assert core.torn_m == pytest.approx(2 * (apart - 1) * STEP_M, abs=0.01)
    assert core.travelled_m - core.looked_at_m == pytest.approx(core.torn_m)
    assert seen < 0.85
    assert "the load jumped back" in belt_findings("front", {"load_torn_m": core.torn_m})["load_torn_m"]


def test_a_frozen_camera_is_noticed_by_the_encoder() -> None:
    scene = Scene(scattered(6, seed=1))
    core = Segmenter(Settings())
    core.step(scene.frame(0, 0.0))
    frozen = scene.frame(0, 0.0)
    stuck = core.step(replace(frozen, seq=1, travel_m=0.0133))
    assert stuck.dropped is FrameDrop.FROZEN
    other = frozen.depth.copy()
    other[-1, -1] += 1
    assert core.step(replace(frozen, seq=2, travel_m=0.0133, depth=other)).dropped is None
    assert core.step(Scene([]).frame(3, 0.02)).dropped is None


@pytest.mark.parametrize("first", [0, 1])
def test_a_camera_that_leaves_out_every_other_row_is_not_blind(first: int) -> None:
    """One that left out the even rows was taken for covered: no frame of it was processed."""
    bodies = scattered(15, seed=1)
    scene = Scene(bodies, noise_m=0.001)
    frames = [scene.frame(i, i * STEP_M) for i in range(70)]
    for frame in frames:
        frame.depth[first::2] = 0
    core, closed = run(frames)
    assert_each_once(closed, bodies, within_m=0.004)
    assert belt_findings("front", core.gauges()) == {}


@pytest.mark.parametrize(("encoder", "still", "told"), [(False, 20, 20), (False, 9, 0), (True, 20, 0)])
def test_a_picture_that_stands_without_an_encoder_is_told(encoder: bool, still: int, told: int) -> None:
    """Tubers that passed a frozen camera were missing without a word; with an encoder such frames are left out."""
    scene = Scene(scattered(15, seed=1), noise_m=0.001)
    frozen = scene.frame(24, 24 * STEP_M).depth
    frames = [scene.frame(i, i * STEP_M, encoder=encoder) for i in range(70)]
    core, _ = run(replace(each, depth=frozen) if 24 < each.seq <= 24 + still else each for each in frames)
    assert core.gauges()["picture_stood"] == told
    found = belt_findings("front", core.gauges()).get("picture_stood", "")
    assert found.startswith("camera 'front': 20 frames in a row are one picture" if told else "")
    assert bool(found) == bool(told)


def test_a_merged_pair_counts_as_two_and_a_late_fragment_as_none() -> None:
    pair = [Body(-0.30, -0.030, 0.035, 0.030, 0.027), Body(-0.30, 0.032, 0.035, 0.030, 0.027)]
    scene = Scene(pair)
    core, closed = Segmenter(Settings()), []
    for i in range(50):
        frame = scene.frame(i, i * STEP_M)
        depth, labels = scene.render(i * STEP_M, i)
        if i % 3 == 1:
            labels = np.minimum(labels, 1).astype(np.uint16)
        if 24 <= i < 27:
            rows, columns = np.nonzero(labels == labels.max())
            piece = columns > np.median(columns) + 6
            labels[rows[piece], columns[piece]] = 3
        closed += core.step(replace(frame, mask=labels, depth=depth)).closed
    assert_each_once(closed + core.finish(), pair, within_m=0.004)


def test_coverage_counts_belt_once_when_it_runs_back() -> None:
    coverage = Coverage(0.5, 0.2)
    for travel_m in (0.0, 0.1, 0.05, 0.1, 0.2):
        coverage.step(travel_m)
    assert (coverage.looked_at_m, coverage.travelled_m) == pytest.approx((0.2, 0.2))


def test_belt_that_a_dead_process_took_with_it_is_seen_as_far_as_a_tuber_is_whole() -> None:
    """Of a restart within half a second nothing was told, and a tuber of 290 g was missed: it had left the view."""
    for missed_m, seen_m in ((0.1, 0.1), (0.16, 0.16), (0.19, 0.16)):
        coverage = Coverage(0.5, 0.2)
        coverage.resume(looked_at_m=1.0, travelled_m=1.0, travel_m=0.3)
        for moved_m in (missed_m, missed_m + 0.02):
            coverage.step(0.3 + moved_m)
        assert coverage.travelled_m == pytest.approx(1.0 + missed_m + 0.02)
        assert coverage.looked_at_m == pytest.approx(1.0 + seen_m + 0.02)


def test_a_board_over_the_belt_costs_its_frames_and_not_the_run() -> None:
    """The segmenter ended for good at the first check of the belt that saw one."""
    scene = Scene(scattered(12, seed=3), noise_m=0.001)
    core, counted, drops = Segmenter(Settings()), 0, []
    for i in range(75):
        frame = scene.frame(i, 0.0133 * i)
        if 28 <= i < 34:
            frame = replace(frame, depth=np.full(frame.depth.shape, 120, np.uint16))
        result = core.step(frame)
        counted += len(result.closed)
        drops += [result.dropped] if result.dropped else []
    counted += len(core.finish())
    assert set(drops) == {FrameDrop.NO_BELT}
    assert len(drops) == 4, "frame 30 is the first that the belt is looked at in, frame 33 the last that hides it"
    assert counted == 12
    assert core.looked_at_m == pytest.approx(core.travelled_m)
