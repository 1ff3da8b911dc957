"""What is drawn of which message: the pure part, without Rerun and without a network."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import viewer_line as line

from conveyor.geometry import Intrinsics, straight_down_belt_from_camera
from conveyor.messages import Counters, Travel
from conveyor.statistics import NORMAL_90
from tests.viewer.page_states import loaded_state
from viewer.scene.belt_scene import RIDE_ON_M, BeltScene
from viewer.scene.health_scene import HealthScene
from viewer.scene.load_scene import LoadScene, page
from viewer.scene.primitives import (
    Bars,
    Box,
    Cloud,
    DepthPicture,
    Entry,
    Gone,
    Lens,
    LogLine,
    Measured,
    Moment,
    Page,
    Pose,
    State,
)
from viewer.scene.profiles import PROFILES
from viewer.scene.shapes import footprint_m
from viewer.scene.travel_log import TravelLog


def one(entries: list[Entry], kind: type) -> Entry:
    found = [entry for entry in entries if isinstance(entry.primitive, kind)]
    assert len(found) == 1, f"{len(found)} primitives of {kind.__name__}"
    return found[0]


def test_travel_is_interpolated_and_never_mixed_between_sources() -> None:
    log = TravelLog()
    assert log.add(Moment(100, 1), 1.0, source="segmenter", estimated=True)
    assert not log.add(Moment(150), 7.0, source="other", estimated=True)
    assert log.add(Moment(200, 2), 2.0, source="segmenter", estimated=True)
    assert log.at(150) == pytest.approx(1.5)
    assert (log.at(99), log.at(201), log.at(200)) == (None, None, 2.0)
    assert log.when(1.5) == Moment(200, 2)
    assert log.when(2.5) is None
    assert log.nearest(150) == Moment(150, 1)
    assert log.add(Moment(210), 30.0, source="encoder", estimated=False), "an encoder replaces an estimate"
    assert log.at(150) is None
    assert not log.add(Moment(220), 2.2, source="segmenter", estimated=True)


def test_a_footprint_is_what_the_corners_see() -> None:
    lens = Intrinsics(401, 201, 200.0, 200.0, 200.0, 100.0)
    prints = footprint_m(lens, straight_down_belt_from_camera(0.5))
    assert prints == pytest.approx((-0.25, 0.25, -0.5, 0.5))


@pytest.mark.parametrize(("profile", "stride"), [("remote", 2), ("full", 1)])
def test_a_picture_is_strided_with_its_lens(profile: str, stride: int) -> None:
    scene = BeltScene(PROFILES[profile])  # type: ignore[index]
    frame = line.frame(0, line.potatoes(3, seed=1))
    entries = scene.on_frame(frame)
    picture, lens = one(entries, DepthPicture), one(entries, Lens)
    assert picture.path == "/belt/camera/front/image/depth"
    assert picture.heavy
    assert isinstance(picture.primitive, DepthPicture)
    assert np.array_equal(picture.primitive.depth, frame.depth[::stride, ::stride])
    assert isinstance(lens.primitive, Lens)
    k = lens.primitive.intrinsics
    assert (k.height, k.width) == picture.primitive.depth.shape
    assert (k.fx * stride, k.cx * stride) == (frame.intrinsics.fx, frame.intrinsics.cx)
    pose = one(entries, Pose)
    assert pose.moment is None
    assert isinstance(pose.primitive, Pose)
    assert np.array_equal(pose.primitive.belt_from_camera, straight_down_belt_from_camera(line.BELT_DISTANCE_M))


def test_pictures_come_at_the_profiles_rate_of_capture_time() -> None:
    scene = BeltScene(PROFILES["remote"])
    drawn = [seq for seq in range(60) if any(e.heavy for e in scene.on_frame(line.frame(seq, [])))]
    assert drawn == list(range(0, 60, 6))


def test_a_tubers_box_rides_from_edge_to_edge_though_counted_late() -> None:
    """Counted long after it was seen, it is drawn at its place from the frame on in which it came into the picture."""
    scene = BeltScene(PROFILES["remote"])
    tuber = line.potatoes(1, seed=2)[0]
    seen_x_m = line.BELT_DISTANCE_M * line.LENS.cy / line.LENS.fy
    gone_at = None
    for seq in range(200):
        if seq == line.crossing_seq(tuber) + 10:
            box = one(scene.on_tuber(line.counted(tuber)), Box)
        gone_at = next((seq for e in scene.on_frame(line.frame(seq, [])) if isinstance(e.primitive, Gone)), gone_at)
    assert isinstance(box.primitive, Box)
    assert box.primitive.label == f"{tuber.weight_g:.0f} g"
    assert box.primitive.center_m[:2] == (tuber.place_x_m, tuber.place_y_m)
    assert box.moment is not None
    entered = next(seq for seq in range(200) if tuber.place_x_m + line.travel_m(seq) >= -seen_x_m)
    assert box.moment == Moment(line.moment_ns(entered), entered)
    left = next(seq for seq in range(200) if tuber.place_x_m + line.travel_m(seq) > seen_x_m + RIDE_ON_M)
    assert gone_at is not None
    assert left <= gone_at <= left + 6


def said(entries: list[Entry]) -> list[str | None]:
    """The labels of boxes, in order; None for one that goes."""
    return [e.primitive.label if isinstance(e.primitive, Box) else None for e in entries]


def test_a_tuber_in_view_carries_a_provisional_weight_until_it_is_counted() -> None:
    """One box per tuber at any time, live and in the past: grey, then by its views, then as counted."""
    scene = BeltScene(PROFILES["light"])
    first, second = line.potatoes(2, seed=2)
    come = scene.on_in_view(line.in_view(3, (first, None)))
    assert said(come) == [""]
    assert scene.on_in_view(line.in_view(9, (first, None))) == [], "nothing new is not drawn"
    weighed = scene.on_in_view(line.in_view(15, (first, 151.2), (second, None)))
    assert said(weighed) == ["≈ 151 g", ""]
    assert weighed[0].path == come[0].path != weighed[1].path
    other = line.in_view(15, (first, 149.0), camera="rear")
    assert scene.on_in_view(other) == [], "what two cameras see at one place is one tuber"

    counted = [e for e in scene.on_tuber(line.counted(first)) if e.path.startswith("/belt/riding")]
    assert {e.path for e in counted} == {come[0].path}
    assert set(said(counted)) == {f"{first.weight_g:.0f} g"}
    assert {Moment(line.moment_ns(3)), Moment(line.moment_ns(15))} <= {e.moment for e in counted}
    assert scene.on_in_view(line.in_view(21, (first, 151.2), (second, None))) == [], "it is counted already"

    clod = replace(line.in_view(24), tracks=(replace(line.in_view(24, (second, None)).tracks[0], state="refused"),))
    assert said(scene.on_in_view(clod)) == [None]
    assert scene.on_in_view(clod) == []


def test_what_is_never_counted_does_not_stay() -> None:
    scene = BeltScene(PROFILES["light"])
    tuber = line.potatoes(1, seed=2)[0]
    scene.on_in_view(line.in_view(3, (tuber, 120.0)))
    assert scene.on_in_view(line.in_view(60)) == [], "it left the picture and is being weighed"
    assert said(scene.on_in_view(line.in_view(120))) == [None]


def test_a_cloud_lies_at_its_tubers_place_and_turns_its_box() -> None:
    scene = BeltScene(PROFILES["full"])
    tubers = line.potatoes(2, seed=5)
    tuber = replace(tubers[0], semi_m=(0.05, 0.03, 0.025), yaw=0.7)
    seq = line.crossing_seq(tuber)
    scene.on_frame(line.frame(seq, [tuber]))
    cloud = one(scene.on_view(line.view(seq, tuber, [tuber])), Cloud)
    assert isinstance(cloud.primitive, Cloud)
    low, high = cloud.primitive.points_m.min(axis=0), cloud.primitive.points_m.max(axis=0)
    assert (low + high)[:2] / 2 == pytest.approx([tuber.place_x_m, tuber.place_y_m], abs=0.004)
    assert high[2] == pytest.approx(0.05, abs=0.002)
    box = one(scene.on_tuber(line.counted(tuber)), Box)
    assert isinstance(box.primitive, Box)
    assert box.primitive.yaw_rad == pytest.approx(0.7, abs=0.1)


def test_the_remote_profile_bounds_the_points_and_leaves_out_lesser_views() -> None:
    scene = BeltScene(PROFILES["remote"])
    tubers = line.potatoes(1, seed=5)
    seq = line.crossing_seq(tubers[0])
    assert scene.on_view(line.view(seq, tubers[0], tubers, rank=1)) == []
    cloud = one(scene.on_view(line.view(seq, tubers[0], tubers)), Cloud)
    assert isinstance(cloud.primitive, Cloud)
    assert 400 <= len(cloud.primitive.points_m) <= 800


def test_travel_alone_moves_the_belt_where_no_frames_are_heard() -> None:
    scene = BeltScene(PROFILES["light"])
    moved = scene.on_travel(Travel("encoder", line.RUN, line.START_NS, 1.25, False))
    assert [(e.path, e.primitive.x_m) for e in moved if hasattr(e.primitive, "x_m")] == [("/belt/riding", 1.25)]


def test_totals_say_weight_count_interval_and_missed_belt() -> None:
    tubers = line.potatoes(12, seed=4)
    report = line.totals(tubers)
    entries = LoadScene().on_totals(report, Moment(5))
    text = page(report)
    assert f"# {report.weight_g / 1000:.2f} kg" in text
    assert "# 12 tubers" in text
    assert "98.5 %" in text
    measured = one(entries, Measured).primitive
    assert isinstance(measured, Measured)
    assert measured.value == pytest.approx(report.weight_g / 1000)
    assert measured.sigma == pytest.approx((report.high_g - report.low_g) / (2 * NORMAL_90) / 1000)
    bars = one(entries, Bars).primitive
    assert isinstance(bars, Bars)
    assert (sum(bars.counts), bars.step) == (12, 50.0)
    nothing = replace(report, count=0, weight_g=0.0, low_g=0.0, high_g=0.0, coverage=None)
    assert "none yet" in page(nothing)
    assert "90 % sure" not in page(nothing), "of nothing no one is sure to 0.00 kg"


@pytest.mark.parametrize("state", ["nothing seen", "starting"])
def test_where_nothing_was_seen_there_is_no_number(state: str) -> None:
    nothing = replace(line.totals([]), count=0, state=state, reason="the lens is covered", coverage=None)
    (entry,) = LoadScene().on_totals(nothing, Moment(5))
    assert isinstance(entry.primitive, Page)
    assert "the lens is covered" in entry.primitive.markdown
    assert "kg" not in entry.primitive.markdown


def test_the_load_is_added_up_tuber_by_tuber_and_never_with_a_hole() -> None:
    scene, tubers = LoadScene(), line.potatoes(4, seed=6)
    kg = [one(scene.on_tuber(line.counted(t), Moment(n)), Page).primitive for n, t in enumerate(tubers[:2])]
    both = (tubers[0].weight_g + tubers[1].weight_g) / 1000
    assert isinstance(kg[1], Page)
    assert f"# {both:.2f} kg" in kg[1].markdown
    assert scene.on_tuber(line.counted(tubers[3]), Moment(3)) == [], "tuber 3 is missing"
    assert scene.on_tuber(line.counted(tubers[2]), Moment(4)) == []
    assert one(scene.on_totals(line.totals(tubers), Moment(5)), Page).primitive == Page(page(line.totals(tubers)))


def counters(pid: int, **values: int) -> Counters:
    return Counters("segmenter", "front", line.RUN, pid, "host", "0", 1.0, values, {})


def test_health_tells_drops_once_and_who_is_gone() -> None:
    scene, now = HealthScene(), Moment(1)
    first = scene.update([counters(1, frame_received=10, frame_dropped_age=2)], {"segmenter/front"}, now)
    assert one(first, State).primitive == State("ok")
    assert "frame_dropped_age +2 (now 2)" in next(e.primitive.text for e in first if isinstance(e.primitive, LogLine))
    again = [counters(1, frame_received=20, frame_dropped_age=2)]
    assert scene.update(again, {"segmenter/front"}, now) == []
    gone = scene.update(again, set(), now)
    assert one(gone, State).primitive == State("gone")
    back = scene.update([counters(2, frame_dropped_age=1)], {"segmenter/front"}, now)
    assert "frame_dropped_age +1 (now 1)" in next(e.primitive.text for e in back if isinstance(e.primitive, LogLine))


def test_the_open_load_is_told_first_in_rerun_and_to_prometheus() -> None:
    told = loaded_state().totals
    assert told is not None
    assert page(told).startswith("# Load 3 · trailer 7 · North 4 · Agria: 206.4 kg")
    assert not page(replace(told, load=None)).startswith("# Load")
    prometheus = pytest.importorskip("tuberline.metrics")
    found = {metric.name: metric.samples[0] for metric in prometheus.totals_metrics(told, line="north", told_now=False)}
    assert found["tuberline_open_load_weight_grams"].value == 206.4e3
    assert "tuberline_load_tubers_per_second" not in found, "of an aggregator that is gone"
    assert found["tuberline_open_load_tubers"].labels == {
        "line": "north", "run": "monday", "load": "3", "name": "trailer 7",
    }  # fmt: skip
    none = prometheus.totals_metrics(replace(told, load=None), line="north", told_now=True)
    assert not [metric.name for metric in none if "open_load" in metric.name]
