"""When a load begins, and that a camera that never saw anything leaves a ledger that can be read."""

from __future__ import annotations

from pathlib import Path

import pytest

from aggregator.core.cameras import Cameras
from aggregator.core.coverage import Moment, coverage
from aggregator.core.load_orders import decide
from aggregator.core.reasons import Unseen
from aggregator.core.sight import CameraSight
from aggregator.ledger.at_rest import order_at_rest
from aggregator.ledger.audit import audit_run
from aggregator.ledger.check import check_file
from aggregator.ledger.loads import last_loads
from aggregator.ledger.reader import read_runs, reading
from aggregator.ledger.writer import Ledger
from conveyor.geometry import Intrinsics
from conveyor.messages import CameraInfo, LoadOrder, Mark, TrackEntry, Travel
from tests.aggregator.belt_story import tell
from tests.aggregator.virtual_line import Aggregator, fresh_run

SECOND_NS = 10**9


def info(*, first_s: float, last_s: float) -> CameraInfo:
    """What a live camera says of the frames that it sent between two of its moments."""
    return CameraInfo(
        "a", "r", "streaming", "test", 10.0, False, Intrinsics(10, 10, 10.0, 10.0, 5.0, 5.0), 0.001, 0, 9, 10, {},
        first_captured_ns=round(first_s * SECOND_NS), last_captured_ns=round(last_s * SECOND_NS), live=True,
    )  # fmt: skip


def lead_s(*, began_s: float, heard_s: float, first_s: float, last_s: float) -> float:
    """Belt before the first frame, in seconds."""
    cameras = Cameras(("a",), stall_s=10.0, now_s=heard_s - 1.0)
    cameras.began(began_s)
    cameras.info(info(first_s=first_s, last_s=last_s), heard_s)
    return cameras.sights["a"].published.lead_s


def test_a_load_begins_with_its_run_and_not_when_its_line_was_joined() -> None:
    """The router came 4 s later: the belt of these 4 s was in no coverage."""
    assert lead_s(began_s=100.0, heard_s=105.5, first_s=5005.0, last_s=5005.5) == pytest.approx(5.0)


def test_frames_sent_before_the_load_began_leave_nothing_before_them() -> None:
    """Seconds in which the camera had sent frames already were taken for belt before its first one."""
    assert lead_s(began_s=100.0, heard_s=103.0, first_s=5000.0, last_s=5018.0) == 0.0


@pytest.mark.parametrize("encoder", [False, True])
def test_belt_that_ran_while_every_camera_was_down_is_told_by_an_encoder(encoder: bool) -> None:
    """By the clock it ran on at its last speed; the encoder knows that it stood most of the time."""
    cameras = Cameras(("a",), stall_s=10.0, now_s=0.0)
    for second in range(1, 11):
        if encoder:
            cameras.travelled(Travel("belt", "r", second * SECOND_NS, 70 + 0.2 * second, False))
        cameras.travelled(Travel("a", "r", second * SECOND_NS, 500.0, False))
        mark = Mark(
            second * SECOND_NS, 0.2 * second, True, second * SECOND_NS, 0, False, 0.2 * second, 0.2 * second, {}, {}, {}
        )
        cameras.heard("a", TrackEntry("a", "r", second, mark=mark), float(second))
        cameras.marked("a", mark)
    if encoder:
        cameras.travelled(Travel("belt", "r", 60 * SECOND_NS, 72.5, False))
    found = coverage(cameras.sights, seen_by={}, moment=cameras.moment(60.0, over=True))
    ran_m = 0.5 if encoder else 50 * 0.2
    assert found.unseen_m["a"][Unseen.AFTER] == pytest.approx(ran_m, abs=0.02)


def test_a_camera_that_wakes_and_repeats_its_last_frame_says_nothing_of_the_belt_meanwhile() -> None:
    """It was frozen 5 s before its line was stopped; let go to end, it said once more what it had said before."""
    cameras = Cameras(("a",), stall_s=10.0, now_s=0.0)
    for second in range(1, 11):
        mark = Mark(
            second * SECOND_NS, 0.2 * second, True, second * SECOND_NS, 0, False, 0.2 * second, 0.2 * second, {}, {}, {}
        )
        cameras.info(info(first_s=1.0, last_s=second), float(second))
        cameras.heard("a", TrackEntry("a", "r", second, mark=mark), float(second))
        cameras.marked("a", mark)
    cameras.info(info(first_s=1.0, last_s=10.0), 15.0)
    found = coverage(cameras.sights, seen_by={}, moment=cameras.moment(15.0, over=True))
    assert found.unseen_m["a"][Unseen.AFTER] == pytest.approx(5 * 0.2, abs=0.02)


def test_what_a_process_took_with_it_was_not_seen_where_the_next_one_only_ends_the_run() -> None:
    """Killed with 90 tubers that waited for weights, started again after the last frame: 53 % seen, none counted."""
    sight = CameraSight()
    for second in range(1, 11):
        s = 0.2 * second
        sight.marked(Mark(second * SECOND_NS, s, True, 3 * SECOND_NS, 0.0, False, s, s, {}, {}, {}))
    sight.marked(Mark(10 * SECOND_NS, 2.0, True, 3 * SECOND_NS, -2.0, True, 0.5, 2.0, {}, {}, {}))
    found = coverage({"a": sight}, seen_by={}, moment=Moment(over=True))
    assert found.share == pytest.approx(0.25)


def test_the_end_by_a_process_that_saw_nothing_forgets_no_speed() -> None:
    sight = CameraSight()
    for second in range(1, 11):
        s = 0.2 * second
        sight.marked(Mark(second * SECOND_NS, s, True, second * SECOND_NS, -s, False, s, s, {}, {}, {}))
    sight.marked(Mark(0, 2.0, False, 0, -2.0, True, 2.0, 2.0, {}, {}, {}))
    assert sight.final
    assert sight.estimated
    assert sight.speed_mps(first=True) == pytest.approx(0.2)
    assert sight.length_m == pytest.approx(2.0)


def test_a_mark_that_holds_a_negative_zero_is_read_as_it_was_written(tmp_path: Path) -> None:
    """SQLite keeps -0.0 as 0: the row of a camera that saw nothing had another checksum when it was read."""
    told = tell(3, cameras=1, n=2).in_run(fresh_run("zero"))
    mark = Mark(0, 0.0, False, 0, -0.0, True, 0.0, -0.0, {}, {}, {})
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = Aggregator(ledger, told)
        it.core.receive(TrackEntry("cam0", told.run, 1, mark=mark), now_s=1.0)
        it.commit()
        it.start()
        assert it.core.finished
    assert check_file(tmp_path / "ledger.db") == []


@pytest.mark.parametrize(("since_s", "unseen_m"), [(20, 4.0), (-1, 0.0), (3600, 0.0)])
def test_belt_that_ran_until_a_line_was_stopped_without_its_aggregator_was_not_seen(
    since_s: int, unseen_m: float
) -> None:
    """By the time of the day, which live cameras stamp; not by a clock that stepped, nor of a line long stopped."""
    before = Cameras(("a",), stall_s=10.0, now_s=0.0)
    before.info(info(first_s=1, last_s=10), 1.0)
    for second in range(1, 11):
        looked_m = 0.2 * (second - 1)
        place = -looked_m, second == 11, looked_m, looked_m
        before.marked("a", Mark(second * SECOND_NS, looked_m, True, second * SECOND_NS, *place, {}, {}, {}))
    cameras = Cameras(("a",), stall_s=10.0, now_s=500.0)
    cameras.restored("a", marks=before.states["a"].marks, curve=[], sight=before.sights["a"])
    cameras.ran_until((10 + since_s) * SECOND_NS, 501.0)
    told = coverage(cameras.sights, seen_by={frozenset(("a",)): 9}, moment=cameras.moment(501.0, over=True))
    assert told.unseen_m["a"].get(Unseen.AFTER, 0.0) == pytest.approx(unseen_m)
    assert told.belt_m == pytest.approx(1.8 + unseen_m)


def test_the_newest_run_is_the_one_begun_last_though_the_clock_was_set_back(tmp_path: Path) -> None:
    """A machine without a clock of its own began the day's second run in 1970: `ledger summary` wrote the first one's,
    and what was said of a load in the evening went to it."""
    path = tmp_path / "ledger.db"
    with Ledger(path) as ledger:
        for run, started_s in (("morning", 1_800_000_000), ("noon", 40)):
            begun = {"cameras": ["a"], "version": "1", "started_ns": started_s * SECOND_NS}
            ledger.open_run(run, line="t", **begun)  # type: ignore[arg-type]
            line = {"utc_offset_s": 0.0, "stated_offset_mm": 0.0}
            order = LoadOrder(run, "start", by="test", fields={"name": run})
            decided = {"run": run, "now_ns": started_s * SECOND_NS, "line": line, "place_x_m": lambda _: 0.0}
            ledger.say(decide(order, ledger.loads, **decided))  # type: ignore[arg-type]
        assert [row.run for row in ledger.runs()] == ["morning", "noon"]
        told = [(run["run"], run["end"]) for run in last_loads(ledger.view, limit=9)]
        assert told == [("noon", "goes on"), ("morning", "cut off")], "the page called a run that was over 'open'"
    assert order_at_rest(path, LoadOrder("n", "note", by="test", note="wet")).name == "noon"
    with reading(path) as view:
        assert [audit_run(view, run).end for run in read_runs(view)] == ["cut off", "cut off"], "as the report has it"
    assert check_file(path) == []
