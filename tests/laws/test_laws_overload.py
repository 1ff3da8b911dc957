"""Law 5 under lasting overload: fewer views per tuber, then fewer frames, and no tuber without a view if it can be.

A live line on a virtual clock: tubers, regressors, their pace and the length of our turns are hypothesis' to choose.
"""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from tests.laws.virtual_overload import LIVE, VIEWS, FloodedLine

SECONDS = 50.0
PATIENT = replace(LIVE, dispatch=replace(LIVE.dispatch, deadline_s=120.0))
lines = st.fixed_dictionaries(
    {
        "per_s": st.floats(2.0, 60.0),
        "takes_s": st.floats(0.005, 1.0),
        "workers": st.integers(1, 4),
        "turn_s": st.floats(0.02, 0.15),
    }
)


def balanced(line: FloodedLine) -> None:
    """Everything that was sent is somewhere, and every frame too."""
    sheet = line.run.counts()["views"]
    lost = sum(n for name, n in sheet.items() if name.startswith("lost_"))
    assert sheet["sent"] == VIEWS * line.belt.closed == sheet["weighed"] + lost + sheet["outstanding"]
    frames = line.run.counts()["frames"]
    drops = sum(n for name, n in frames.items() if name.startswith("dropped_"))
    assert frames["published"] == frames["processed"] + drops + frames["gaps"] == line.frames


@settings(max_examples=12, deadline=None, derandomize=True, phases=[Phase.explicit, Phase.generate])
@given(shape=lines)
def test_every_tuber_is_weighed_where_the_regressors_can_weigh_one_view_of_each(shape: dict[str, float]) -> None:
    line = FloodedLine(**shape)  # type: ignore[arg-type]
    line.run_for(SECONDS)
    balanced(line)
    dispatcher, capacity = line.run.dispatcher, line.capacity_per_s
    assert "weigh_deadline" not in line.lost
    assert line.latest_log_s <= LIVE.weigh_deadline_s
    assert line.most_outstanding <= LIVE.max_pending_views * 10 + 16 * line.workers
    if capacity >= 1.1 * line.per_s:
        assert not line.never_weighed
        assert "overload" not in line.lost
        assert line.latest_log_s <= LIVE.dispatch.spare_wait_s + 3 * line.takes_s + 2.0
    else:
        assert dispatcher.weighed >= 0.9 * capacity * SECONDS - 20, "regressors stood idle under overload"
    if capacity >= 1.1 * VIEWS * line.per_s:
        assert not line.lost, "views were shed without need"


@pytest.mark.parametrize("refuse_first", [False, True])
def test_what_cannot_be_weighed_is_given_up_early_flagged_and_counted(refuse_first: bool) -> None:
    """25 tubers a second, regressors for 12: each of those is a tuber's first, or the one in place of a refused one."""
    line = FloodedLine(per_s=25.0, takes_s=1 / 12, workers=1, turn_s=0.05, refuse_first=refuse_first)
    line.run_for(90.0)
    balanced(line)
    late = [track for track in line.logged if track.crossed_ns > 45e9]
    never = [track for track in late if not track.views]
    assert never
    reasons = {"overload", "weigh_deadline"} if refuse_first else {"overload"}
    assert all(reasons & track.views_lost.keys() for track in never)
    assert sum(len(track.views) for track in late) == len(late) - len(never), "a second view cost a tuber its first"
    assert line.run.dispatcher.pace.total_per_s(line.crew) == pytest.approx(12.0, rel=0.1)
    views_each = 2 if refuse_first else 1
    assert len(line.logged) - len(line.never_weighed) >= 0.95 * (line.now_s - 30.0 * (views_each - 1)) * 12 / views_each


def test_regressors_that_take_longer_than_is_remembered_are_slow_and_not_unknown() -> None:
    """Eight on two cores took 16 s a view: 2048 tubers of each camera waited for their deadline of 60 s."""
    line = FloodedLine(per_s=17.0, takes_s=12.0, workers=8, turn_s=0.5, settings=PATIENT)
    line.run_for(150.0)
    balanced(line)
    assert line.run.dispatcher.outstanding < 150
    assert line.lost["overload"] > 10 * line.lost.get("weigh_deadline", 0)
    assert line.run.dispatcher.weighed > 0.3 * line.capacity_per_s * 150.0


def test_a_regressor_that_sleeps_for_a_while_costs_no_tuber_its_weight() -> None:
    """Everybody stands still for 20 s, say a router that was frozen: what waits is weighed when they wake up."""
    line = FloodedLine(per_s=15.0, takes_s=0.02, workers=2, turn_s=0.05)
    line.run_for(30.0)
    line.asleep_until_s = line.now_s + 20.0
    line.run_for(80.0)
    balanced(line)
    assert not line.never_weighed
    assert line.lost.keys() <= {"shed"}
    assert line.run.dispatcher.outstanding < 3 * VIEWS


def test_regressors_that_never_come_back_let_tubers_go_by_volume_at_the_deadline() -> None:
    line = FloodedLine(per_s=5.0, takes_s=0.02, workers=1, turn_s=0.1, settings=replace(LIVE, weigh_deadline_s=20.0))
    line.run_for(10.0)
    line.asleep_until_s = 1e9
    line.run_for(60.0)
    balanced(line)
    assert line.never_weighed
    assert {reason for track in line.never_weighed for reason in track.views_lost} <= {
        "shed", "weigh_deadline", "max_attempts",
    }  # fmt: skip
    assert line.latest_log_s <= 20.5


def test_frames_are_left_out_only_when_tubers_wait_for_their_first_view() -> None:
    """A tuber is still looked at every 60 mm of belt."""
    calm = FloodedLine(per_s=15.0, takes_s=1 / 25, workers=1, turn_s=1 / 30)
    flooded = FloodedLine(per_s=25.0, takes_s=1 / 12, workers=1, turn_s=1 / 30)
    for line in (calm, flooded):
        line.run_for(40.0)
        balanced(line)
    assert calm.run.frames.dropped == {}
    assert flooded.run.frames.dropped["overload"] > 0.5 * flooded.frames
    assert 0.01 < flooded.belt.longest_step_m <= 0.0601


@pytest.mark.parametrize("lives", [True, False])
def test_frames_are_left_out_only_when_a_living_aggregator_does_not_keep_up(
    lives: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that is away, and comes back, costs no frame; what one that is too slow is sent has a limit."""
    monkeypatch.setattr("segmenter.camera_run.MOST_BEHIND", 200)
    line = FloodedLine(per_s=15.0, takes_s=0.01, workers=1, turn_s=1 / 30, confirms_per_s=0.0)
    line.run.aggregator_lives = lives
    line.run_for(40.0)
    balanced(line)
    if lives:
        assert 200 < line.run.log.uncommitted <= 250
        assert line.run.frames.dropped["behind"] > 0.5 * line.frames
    else:
        assert line.run.log.uncommitted > 600
        assert line.run.frames.dropped == {}
    line.confirms_per_s, left_out = math.inf, line.run.frames.dropped["behind"]
    line.run_for(1.0)
    assert line.run.frames.dropped["behind"] <= left_out + 1
