"""The dispatcher's law, on histories that hypothesis makes up: sent = weighed + lost + outstanding, at every moment."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from segmenter_scene import SMALL

from conveyor.geometry import straight_down_belt_from_camera
from conveyor.messages import View
from segmenter.dispatch.dispatcher import Dispatcher, DispatchSettings


def view(track: int, rank: int) -> View:
    return View(
        view_id=f"r1/front/{track}/{rank}",
        track_id=f"r1/front/{track}",
        camera="front",
        run="r1",
        seq=rank,
        captured_ns=0,
        rank=rank,
        depth_scale_m=0.001,
        intrinsics=SMALL,
        u0=0,
        v0=0,
        depth=np.ones((2, 2), np.uint16),
        belt_from_camera=straight_down_belt_from_camera(0.46),
    )


class DispatchStory(RuleBasedStateMachine):
    """Regressors come, go, answer, refuse, repeat themselves and fall asleep; views keep coming."""

    def __init__(self) -> None:
        super().__init__()
        self.now_s = 0.0
        self.names: set[str] = set()
        self.tracks = 0
        self.assigned: list[tuple[str, View]] = []
        self.known: set[str] = set()
        self.weighed: set[str] = set()
        self.lost: dict[str, str] = {}
        self.refused_since_expiry = 0
        self.dispatcher = Dispatcher(
            DispatchSettings(credits=2, most_credits=2, deadline_s=1.0, max_attempts=3, shed_over=8, spare_wait_s=3.0)
        )

    @rule(views=st.integers(1, 4))
    def tuber(self, views: int) -> None:
        self.tracks += 1
        for rank in range(views):
            offered = view(self.tracks, rank)
            self.known.add(offered.view_id)
            self.dispatcher.offer(offered, now_s=self.now_s)
        self._expire()

    @rule(name=st.sampled_from("abc"))
    def join(self, name: str) -> None:
        self.names.add(name)
        self.dispatcher.present(set(self.names))

    @rule(name=st.sampled_from("abc"))
    def leave(self, name: str) -> None:
        self.names.discard(name)
        self.dispatcher.present(set(self.names))

    @rule()
    def assign(self) -> None:
        for name, sent in self.dispatcher.assign(self.now_s):
            assert name in self.names
            assert sent.view_id not in self.weighed | set(self.lost), "a settled view was sent again"
            self.assigned.append((name, sent))

    @precondition(lambda self: bool(self.assigned))
    @rule(data=st.data(), usable=st.booleans())
    def answer(self, data: st.DataObject, usable: bool) -> None:
        name, sent = data.draw(st.sampled_from(self.assigned))
        settled = sent.view_id in self.weighed or sent.view_id in self.lost
        new = self.dispatcher.answer(sent.view_id, regressor=name, usable=usable)
        self.refused_since_expiry += new and not usable
        self._note_losses()
        assert new or settled or sent.view_id in self.lost
        if new and usable:
            assert sent.view_id not in self.weighed, "one view was weighed twice"
            self.weighed.add(sent.view_id)

    @rule(seconds=st.floats(0.0, 1.5))
    def wait(self, seconds: float) -> None:
        self.now_s += seconds
        self._expire()

    @rule(track=st.integers(1, 30))
    def give_up(self, track: int) -> None:
        self.dispatcher.cancel(f"r1/front/{track}", "weigh_deadline")

    @invariant()
    def nothing_lost_silently(self) -> None:
        self._note_losses()
        balance = self.dispatcher.balance()
        lost = sum(n for name, n in balance.items() if name.startswith("lost_"))
        assert balance["sent"] == balance["weighed"] + lost + balance["outstanding"] == len(self.known)
        assert balance["weighed"] == len(self.weighed)
        assert lost == len(self.lost)

    @invariant()
    def bounds_are_kept(self) -> None:
        held = [sum(job.regressor == name for job in self.dispatcher._jobs.values()) for name in self.names]
        assert all(n <= 2 for n in held)
        jobs = self.dispatcher._jobs.values()
        waiting = [job for job in jobs if job.regressor is None and not job.fallback]
        # A refused view's place is taken by one that stood aside: until the next turn one more may wait for each.
        most = 8 + self.refused_since_expiry
        assert len(waiting) <= most or all(job.first for job in waiting) or self.dispatcher.requeued
        assert sum(job.fallback for job in jobs) <= sum(job.first for job in jobs)
        assert len(waiting) <= 8 * 8 + sum(self.dispatcher.requeued.values())

    def _expire(self) -> None:
        self.dispatcher.expire(self.now_s)
        self.refused_since_expiry = 0

    def _note_losses(self) -> None:
        for loss in self.dispatcher.take_losses():
            assert loss.view_id not in self.lost, "one view was lost twice"
            if loss.reason == "shed":
                others = {v for v in self.known if v.startswith(f"{loss.track_id}/")}
                fallback = others - set(self.lost) - {loss.view_id}
                assert fallback, "the last view of a tuber was shed"
            self.lost[loss.view_id] = loss.reason


TestDispatchStory = DispatchStory.TestCase
TestDispatchStory.settings = settings(max_examples=120, stateful_step_count=40, deadline=None)


@pytest.mark.parametrize(("shed_over", "ranks"), [(100, [0, 0, 0, 1, 1, 1]), (None, [0, 1, 0, 1, 0, 1])])
def test_first_views_go_first_on_a_live_line_and_tuber_by_tuber_in_a_replay(
    shed_over: int | None, ranks: list[int]
) -> None:
    """A replay weighs them all: with first views first the ledger had nothing before the recording's end."""
    dispatcher = Dispatcher(DispatchSettings(credits=100, shed_over=shed_over))
    for track in (1, 2, 3):
        for rank in (0, 1):
            dispatcher.offer(view(track, rank))
    dispatcher.present({"a"})
    assert [sent.rank for _, sent in dispatcher.assign(0.0)] == ranks


def test_a_killed_regressors_views_go_to_another() -> None:
    dispatcher = Dispatcher(DispatchSettings(credits=1))
    dispatcher.offer(view(1, 0))
    dispatcher.present({"a"})
    assert [name for name, _ in dispatcher.assign(0.0)] == ["a"]
    dispatcher.present({"b"})
    assert [(name, sent.view_id) for name, sent in dispatcher.assign(0.1)] == [("b", "r1/front/1/0")]
    assert dispatcher.requeued == {"regressor_left": 1}


def test_a_frozen_regressor_gets_one_view_at_a_time_until_it_answers() -> None:
    dispatcher = Dispatcher(DispatchSettings(credits=2, deadline_s=1.0, max_attempts=9))
    for track in range(1, 4):
        dispatcher.offer(view(track, 0))
    dispatcher.present({"a"})
    assert len(dispatcher.assign(0.0)) == 2
    dispatcher.expire(1.0)
    assert len(dispatcher.assign(1.0)) == 1
    dispatcher.answer("r1/front/1/0", regressor="a", usable=True)
    assert len(dispatcher.assign(1.1)) == 2


def test_the_only_regressor_standing_still_costs_no_view() -> None:
    """Stuck for 30 s it was asked five times for one view, which was then lost, and the ledger was another one."""
    dispatcher = Dispatcher(DispatchSettings(credits=2, deadline_s=5.0, max_attempts=3))
    for track in (1, 2):
        dispatcher.offer(view(track, 0))
    dispatcher.present({"a"})
    for second in range(60):
        dispatcher.expire(float(second))
        dispatcher.assign(float(second))
    for track in (1, 2):
        dispatcher.answer(f"r1/front/{track}/0", regressor="a", usable=True)
    assert dispatcher.balance() == {"sent": 2, "weighed": 2, "outstanding": 0}


def test_a_view_that_kills_its_regressors_is_lost_with_its_reason() -> None:
    dispatcher = Dispatcher(DispatchSettings(credits=1, max_attempts=2))
    dispatcher.offer(view(1, 0))
    for name in ("a", "b"):
        dispatcher.present({name})
        assert len(dispatcher.assign(0.0)) == 1
    dispatcher.present(set())
    assert [loss.reason for loss in dispatcher.take_losses()] == ["max_attempts"]
    assert dispatcher.balance() == {"sent": 1, "weighed": 0, "outstanding": 0, "lost_max_attempts": 1}


def test_overload_sheds_the_highest_ranks_and_never_a_first_view() -> None:
    dispatcher = Dispatcher(DispatchSettings(shed_over=6))
    for track in range(1, 9):
        for rank in (0, 1, 2):
            dispatcher.offer(view(track, rank))
    dispatcher.expire(0.0)
    assert dispatcher.lost == {"shed": 8}, "the second view of each stands aside until its first one is weighed"
    dispatcher.present({"a"})
    sent = []
    for _ in range(20):
        for name, due in dispatcher.assign(0.0):
            sent.append(due.rank)
            dispatcher.answer(due.view_id, regressor=name, usable=True)
    assert sent == [0] * 8
    assert dispatcher.balance() == {"sent": 24, "weighed": 8, "outstanding": 0, "lost_shed": 16}


def test_a_view_set_aside_takes_the_place_of_a_refused_one() -> None:
    """A tuber whose best view was refused went to its volume, its other views having been shed before."""
    dispatcher = Dispatcher(DispatchSettings(shed_over=3))
    for track in (1, 2, 3):
        for rank in (0, 1):
            dispatcher.offer(view(track, rank))
    dispatcher.expire(0.0)
    dispatcher.present({"a"})
    weighed = set()
    for _ in range(20):
        for name, due in dispatcher.assign(0.0):
            usable = due.rank > 0 or due.track_id.endswith("/3")
            dispatcher.answer(due.view_id, regressor=name, usable=usable, reason="few_points")
            weighed |= {due.track_id} if usable else set()
    assert weighed == {"r1/front/1", "r1/front/2", "r1/front/3"}
    assert dispatcher.lost == {"refused_few_points": 2, "shed": 1}


def test_only_tubers_that_nobody_can_weigh_in_time_are_given_up_and_the_newest_first() -> None:
    """Ten tubers a second, one regressor that weighs five."""
    dispatcher = Dispatcher(DispatchSettings(shed_over=100, first_wait_s=2.0, spare_wait_s=1.0))
    dispatcher.present({"a"})
    in_hand: list[str] = []
    for track in range(300):
        now_s = track * 0.1
        dispatcher.offer(view(track, 0), now_s=now_s)
        dispatcher.expire(now_s)
        if track % 2 and in_hand:
            assert dispatcher.answer(in_hand.pop(0), regressor="a", usable=True)
        in_hand += [due.view_id for _, due in dispatcher.assign(now_s)]
    assert dispatcher.weighed == 150
    assert dispatcher.lost.keys() == {"overload"}
    assert sum(job.regressor is None for job in dispatcher._jobs.values()) <= 2.0 * 5 + 1
    assert {int(loss.track_id.rsplit("/", 1)[1]) for loss in dispatcher.take_losses()}.isdisjoint(range(1, 10))


@pytest.mark.parametrize("names", [set(), {"a"}])
def test_the_queue_is_bounded_while_no_one_or_too_few_weigh(names: set[str]) -> None:
    """What had been given up stayed in the queue until its turn: without a regressor, and for the spare views of an
    overload that lasts, forever. 0.6 GB a day at ten tubers a second."""
    dispatcher, now_s = Dispatcher(DispatchSettings(shed_over=8)), 0.0
    dispatcher.present(names)
    for number in range(600):
        now_s += 0.1
        for rank in range(3):
            dispatcher.offer(view(number, rank), now_s=now_s)
        dispatcher.expire(now_s)
        if number >= 20:
            dispatcher.cancel(f"r1/front/{number - 20}", "weigh_deadline")
        for name, sent in dispatcher.assign(now_s)[: number % 4 == 0]:
            dispatcher.answer(sent.view_id, regressor=name, usable=True)
        assert dispatcher.outstanding <= 64
        assert len(dispatcher._queue) <= 2 * 64
    balance = dispatcher.balance()
    assert balance["sent"] == 1800
    assert (balance["weighed"] > 0) == bool(names)


def test_a_second_answer_changes_nothing() -> None:
    dispatcher = Dispatcher(DispatchSettings())
    dispatcher.offer(view(1, 0))
    dispatcher.present({"a"})
    dispatcher.assign(0.0)
    assert dispatcher.answer("r1/front/1/0", regressor="a", usable=True)
    assert not dispatcher.answer("r1/front/1/0", regressor="a", usable=True)
    assert dispatcher.duplicates == 1
    assert dispatcher.balance() == {"sent": 1, "weighed": 1, "outstanding": 0}
