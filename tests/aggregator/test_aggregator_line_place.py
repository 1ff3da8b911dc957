"""Which place lies at the centre row now, and which did when an order was given; the clock is ours."""

from __future__ import annotations

import math

import pytest

from aggregator.core.cameras import Cameras
from aggregator.core.line_place import SETTLED_S, NotYetKnownError, place_now_x_m
from conveyor.errors import InputError
from conveyor.geometry import Intrinsics
from conveyor.messages import CameraInfo, Mark, TrackEntry

SPEED_MPS, FIRST_S, ROW_M, STALL_S = 0.4, 50.0, 0.12, 10.0


def mark(at_s: float, *, estimated: bool = False, final: bool = False, travel_m: float | None = None) -> Mark:
    """Of a camera whose clock said `FIRST_S` when the belt began to move."""
    ns = round((FIRST_S + at_s) * 1e9)
    travel = SPEED_MPS * at_s if travel_m is None else travel_m
    return Mark(
        captured_ns=ns, travel_m=travel, travel_estimated=estimated, complete_ns=ns,
        complete_place_x_m=-travel, final=final, looked_at_m=travel, travelled_m=travel,
        frames={"processed": 1}, views={}, tracks={},
    )  # fmt: skip


def told(cameras: Cameras, camera: str, *marks: Mark, now_s: float) -> None:
    for n, one in enumerate(marks, start=1):
        cameras.heard(camera, TrackEntry(camera, "r", n, mark=one), now_s)
        cameras.marked(camera, one)


def a_line(names: tuple[str, ...] = ("a",), *, until_s: float = 5.0, estimated: bool = False) -> Cameras:
    """Cameras that send a mark four times a second, heard as they are made: now is seconds of the story."""
    cameras = Cameras(names, stall_s=STALL_S, now_s=0.0)
    for at in range(int(until_s * 4) + 1):
        for name in names:
            told(cameras, name, mark(at / 4, estimated=estimated), now_s=at / 4)
    for name in names:
        cameras.crossed(name, ROW_M)
    return cameras


@pytest.mark.parametrize("estimated", [False, True])
@pytest.mark.parametrize(("now_s", "age_s"), [(5.0, 0.0), (5.2, 0.0), (5.2, 0.5), (5.0, 4.0), (8.0, 0.0)])
def test_the_place_of_the_moment_at_which_it_was_asked(now_s: float, age_s: float, estimated: bool) -> None:
    cameras = a_line(("a", "b"), estimated=estimated)
    cameras.watermark_x_m(now_s)
    found = place_now_x_m(cameras, now_s=now_s, age_s=age_s)
    assert found == pytest.approx(ROW_M - SPEED_MPS * (now_s - age_s), abs=1e-6)


def test_before_the_first_mark_a_load_begins_with_the_run() -> None:
    assert place_now_x_m(Cameras(("a",), stall_s=10, now_s=0.0), now_s=3.0, age_s=0.0) == math.inf


def test_after_a_restart_the_first_marks_are_not_taken_for_news() -> None:
    """They waited for the new process: what it hears first is old, what it hears a second later is not."""
    cameras = Cameras(("a",), stall_s=STALL_S, now_s=7.0)
    told(cameras, "a", *(mark(at / 4) for at in range(16)), now_s=7.0)
    with pytest.raises(NotYetKnownError, match="waiting for a"):
        place_now_x_m(cameras, now_s=7.0 + SETTLED_S / 2, age_s=0.0)
    told(cameras, "a", *(mark(at / 4) for at in range(16, 33)), now_s=8.0)
    assert place_now_x_m(cameras, now_s=8.0, age_s=2.5) == pytest.approx(-SPEED_MPS * 5.5, abs=1e-6)


@pytest.mark.parametrize("age_s", [0.0, 2.5])
def test_marks_that_waited_for_the_new_process_say_nothing_of_the_pace(age_s: float) -> None:
    """4 s of them came at once: the camera seemed to run 2.5 times as fast, and an order of 2.5 s ago lay 1.3 m off."""
    cameras = Cameras(("a",), stall_s=STALL_S, now_s=7.0)
    told(cameras, "a", *(mark(at / 4) for at in range(17)), now_s=7.0)
    for at in range(17, 28):
        told(cameras, "a", mark(at / 4), now_s=3.0 + at / 4)
    assert place_now_x_m(cameras, now_s=10.0, age_s=age_s) == pytest.approx(-SPEED_MPS * (7.0 - age_s), abs=1e-6)


def test_a_belt_that_stands_while_its_segmenter_is_gone_is_known_by_the_encoder() -> None:
    """The camera goes on publishing what the encoder says: the belt stopped at 2.2 m, the marks end at 2 m."""
    cameras = a_line(until_s=5.0)
    lens = Intrinsics(10, 10, 10.0, 10.0, 5.0, 5.0)
    info = CameraInfo(
        "a", "r", "streaming", "test", 30.0, True, lens, 0.001, 0, 299, 300, {}, live=True,
        first_captured_ns=round(FIRST_S * 1e9), last_captured_ns=round((FIRST_S + 12.0) * 1e9),
        first_travel_m=0.0, last_travel_m=2.2,
    )  # fmt: skip
    cameras.info(info, 12.0)
    assert place_now_x_m(cameras, now_s=12.0, age_s=0.0) == pytest.approx(ROW_M - 2.2)
    without = a_line(until_s=5.0)
    assert place_now_x_m(without, now_s=12.0, age_s=0.0) == pytest.approx(ROW_M - SPEED_MPS * 12.0)
    assert place_now_x_m(without, now_s=40.0, age_s=0.0) == pytest.approx(ROW_M - SPEED_MPS * (5.0 + STALL_S))


def test_a_silent_first_camera_is_passed_over() -> None:
    cameras = a_line(("a", "b"), until_s=5.0)
    for at in range(21, 100):
        told(cameras, "b", mark(at / 4), now_s=at / 4)
    assert place_now_x_m(cameras, now_s=25.0, age_s=0.0) == pytest.approx(ROW_M - SPEED_MPS * 25.0)


def test_where_every_camera_ended_there_is_no_place() -> None:
    cameras = a_line()
    told(cameras, "a", mark(6.0, final=True), now_s=6.0)
    with pytest.raises(InputError, match="every camera has ended"):
        place_now_x_m(cameras, now_s=6.5, age_s=0.0)
