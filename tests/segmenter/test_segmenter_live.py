"""A live line's run: a tuber goes to the log with its first answer, spare views are let go, marks come often."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conveyor.config import CameraConfig, LineConfig
from conveyor.messages import TrackEntry
from conveyor.processors import Busy
from conveyor.reasons import Requeue, ViewLoss
from segmenter.camera_run import LIVE_MARK_EVERY_NS, MARK_EVERY_NS
from segmenter.dispatch.dispatcher import Dispatcher, DispatchSettings
from segmenter.dispatch.view_budget import ViewBudget
from segmenter.setup import run_settings
from tests.laws.virtual_overload import VIEWS, FloodedLine
from tests.segmenter.test_segmenter_dispatch import view

SHIPPED = run_settings(LineConfig(cameras={"front": CameraConfig(waits=False)}), "front")
REPLAY = run_settings(LineConfig(cameras={"front": CameraConfig(waits=True)}), "front")
EVERYTHING = replace(SHIPPED, fewer_views=False)


def marks_ns(line: FloodedLine, seconds: float) -> list[int]:
    found: list[TrackEntry] = []
    line.run.log.commit = lambda n: None  # type: ignore[method-assign]
    line.run_for(seconds)
    line.run.log.resend()
    while entries := line.run.log.due(line.now_s):
        found += entries
    return [entry.mark.captured_ns for entry in found if entry.mark is not None]


def balanced(line: FloodedLine) -> None:
    sheet = line.run.counts()["views"]
    lost = Counter({name.removeprefix("lost_"): n for name, n in sheet.items() if name.startswith("lost_")})
    assert sheet["sent"] == VIEWS * line.belt.closed == sheet["weighed"] + lost.total() + sheet["outstanding"]
    for track in line.logged:
        assert track.views_sent == VIEWS == len(track.views) + sum(track.views_lost.values())


def test_a_line_that_waits_keeps_every_view_and_its_marks() -> None:
    assert (REPLAY.spare_grace_s, REPLAY.fewer_views, REPLAY.mark_every_ns) == (None, False, MARK_EVERY_NS)
    assert REPLAY.dispatch.shed_over is None
    assert (SHIPPED.spare_grace_s, SHIPPED.fewer_views, SHIPPED.mark_every_ns) == (0.06, True, LIVE_MARK_EVERY_NS)


def test_marks_come_with_the_first_frame_that_is_due() -> None:
    """Law: not more often than asked for, and at most a frame later."""
    line = FloodedLine(per_s=5.0, takes_s=0.01, workers=2, turn_s=0.05, settings=EVERYTHING)
    apart_ns = np.diff(marks_ns(line, 5.0))
    assert min(apart_ns) >= LIVE_MARK_EVERY_NS
    assert max(apart_ns) < LIVE_MARK_EVERY_NS + 50_000_000


@pytest.mark.parametrize("per_s", [5.0, 15.0, 24.0])
def test_a_tuber_is_logged_with_its_first_answer_and_late_views_are_counted(per_s: float) -> None:
    """Two regressors for 25 views a second each: enough for three views of 15 tubers, for two of 24."""
    line = FloodedLine(per_s=per_s, takes_s=0.04, workers=2, turn_s=0.02, settings=EVERYTHING)
    line.run_for(30.0)
    balanced(line)
    assert not line.never_weighed
    assert line.lost.keys() <= {ViewLoss.LATE, ViewLoss.SHED}
    assert line.latest_log_s <= 1.0, "of the virtual clock"
    assert (line.lost == {}) == (VIEWS * per_s <= line.capacity_per_s)


def test_without_grace_only_the_first_answer_is_waited_for() -> None:
    line = FloodedLine(
        per_s=10.0, takes_s=0.04, workers=1, turn_s=0.05, settings=replace(EVERYTHING, spare_grace_s=0.0)
    )
    line.run_for(20.0)
    balanced(line)
    assert not line.never_weighed
    assert line.lost[ViewLoss.LATE] > 0


def test_fewer_views_are_weighed_while_regressors_are_busy_and_all_again_afterwards() -> None:
    line = FloodedLine(per_s=20.0, takes_s=0.04, workers=1, turn_s=0.02, settings=SHIPPED)
    line.run_for(20.0)
    balanced(line)
    assert line.run.budget.views == 1
    assert line.run.budget.reduced >= 2
    assert not line.never_weighed
    line.belt.per_s = 2.0
    line.belt.closed = int(line.belt.now_s * 2.0)
    line.run_for(20.0)
    assert line.run.budget.views == 3


@given(
    most=st.integers(1, 16),
    seen=st.lists(st.tuples(st.floats(0.0, 5.0), st.integers(0, 4), st.integers(0, 4)), max_size=60),
)
def test_the_budget_stays_between_one_view_and_all(most: int, seen: list[tuple[float, int, int]]) -> None:
    budget, now_s = ViewBudget(most), 0.0
    for elapsed_s, busy, idle in seen:
        now_s += elapsed_s
        budget.step(now_s, busy=busy, of=busy + idle)
        assert 1 <= budget.views <= most
        assert 0.0 <= budget.share <= 1.0


def shown(busy_share: float, *, seconds: float, budget: ViewBudget) -> int:
    """Views of a tuber after so long on a machine that is as busy; its two regressors work for half of the time."""
    machine, at_s = Busy(busy_share, 2), 0.0 if budget._now_s is None else budget._now_s
    for turn in range(round(seconds / 0.05)):
        budget.step(at_s + 0.05 * turn, busy=turn % 2, of=2, machine=machine)
    return budget.views


def test_second_and_third_views_leave_a_part_of_the_machine_free() -> None:
    budget = ViewBudget(3, free_share=0.3)
    assert shown(0.9, seconds=20.0, budget=budget) == 1
    assert shown(0.6, seconds=20.0, budget=budget) == 1, "another view of each tuber would take what is to stay free"
    assert shown(0.1, seconds=20.0, budget=budget) == 3
    assert shown(0.71, seconds=20.0, budget=budget) == 1, "it stays above the share that is to be free"
    assert budget.machine_share == pytest.approx(0.71, abs=1e-3)


def test_a_busy_machine_is_no_matter_where_the_regressors_run_elsewhere() -> None:
    beside = LineConfig(cameras={"front": CameraConfig(waits=False)})
    elsewhere = beside.model_copy(update={"regressor": beside.regressor.model_copy(update={"processes": 0})})
    assert (run_settings(beside, "front").free_share, run_settings(elsewhere, "front").free_share) == (0.3, 0.0)
    assert shown(1.0, seconds=20.0, budget=ViewBudget(3, run_settings(elsewhere, "front").free_share)) == 3


def test_a_tuber_gets_one_view_while_what_waits_takes_longer_than_a_moment() -> None:
    dispatcher, budget = Dispatcher(DispatchSettings(credits=1, most_credits=1, shed_over=100)), ViewBudget(3)
    dispatcher.present({"a"})
    for track in range(8):
        dispatcher.offer(view(track, 0))
    assert dispatcher.backlog_s == 0.0, "the pace is not known yet"
    for at in range(6):
        [(_, sent)] = dispatcher.assign(0.1 * at)
        dispatcher.expire(0.1 * (at + 1))
        dispatcher.answer(sent.view_id, regressor="a", usable=True)
    assert dispatcher.backlog_s == pytest.approx(2 / dispatcher.rate_per_s)
    assert (budget.now(dispatcher.backlog_s), budget.now(0.0)) == (1, 3)


@pytest.mark.parametrize("live", [True, False])
def test_a_view_lost_on_the_way_goes_to_the_next_at_the_following_answer(live: bool) -> None:
    """Views of 13 kB were lost in a full transmit queue, and each held every ledger up for the deadline of 5 s."""
    dispatcher = Dispatcher(DispatchSettings(credits=4, max_attempts=2, shed_over=100 if live else None))
    dispatcher.present({"a"})
    for track in (1, 2, 3):
        dispatcher.offer(view(track, 0))
    first, lost, last = (sent.view_id for _, sent in dispatcher.assign(0.0))
    assert dispatcher.answer(first, regressor="a", usable=True)
    assert not dispatcher.requeued
    assert dispatcher.answer(last, regressor="a", usable=True)
    assert dispatcher.requeued == {Requeue.LOST_ON_THE_WAY: 1}
    assert [sent.view_id for _, sent in dispatcher.assign(0.01)] == [lost]
    dispatcher.offer(view(4, 0))
    [(_, fourth)] = dispatcher.assign(0.02)
    assert dispatcher.answer(fourth.view_id, regressor="a", usable=True)
    assert dispatcher.balance().get("lost_max_attempts", 0) == live, "only a live line ends by attempts"
    assert dispatcher.balance()["outstanding"] == (not live)


def test_a_view_beyond_the_budget_stands_in_for_one_that_is_refused() -> None:
    dispatcher = Dispatcher(DispatchSettings(credits=4, shed_over=100))
    dispatcher.present({"a"})
    for rank in range(3):
        dispatcher.offer(view(1, rank), spare=rank >= 1)
    [(_, first)] = dispatcher.assign(0.0)
    assert first.rank == 0
    assert dispatcher.balance() == {"sent": 3, "weighed": 0, "outstanding": 2, "lost_shed": 1}
    assert dispatcher.answer(first.view_id, regressor="a", usable=False)
    assert [sent.rank for _, sent in dispatcher.assign(0.1)] == [1]


def test_a_live_regressor_that_went_silent_is_given_up_after_several_times_its_usual_time() -> None:
    dispatcher = Dispatcher(DispatchSettings(credits=1, shed_over=100))
    dispatcher.present({"a"})
    for track in range(20):
        dispatcher.offer(view(track, 0))
        [(_, sent)] = dispatcher.assign(float(track))
        dispatcher.expire(track + 0.02)
        assert dispatcher.answer(sent.view_id, regressor="a", usable=True)
    dispatcher.offer(view(99, 0))
    dispatcher.assign(100.0)
    dispatcher.expire(100.99)
    assert not dispatcher.requeued
    dispatcher.expire(101.01)
    assert dispatcher.requeued == {Requeue.DEADLINE: 1}
