"""Pacing and the send window, without sockets and clocks."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from camera_sim.flow import LONGEST_STEP_S, RESEND_AFTER_S, Pace, SendWindow
from conveyor.geometry import Intrinsics
from conveyor.messages import Frame


def _frame(seq: int) -> Frame:
    return Frame(
        camera="c",
        run="r",
        seq=seq,
        captured_ns=seq,
        travel_m=None,
        depth_scale_m=0.001,
        intrinsics=Intrinsics(2, 2, 1, 1, 1, 1),
        belt_distance_m=None,
        depth=np.zeros((2, 2), np.uint16),
    )


def test_frames_are_due_at_their_own_pace() -> None:
    for speed in (1.0, 2.0):
        pace = Pace(speed)
        due = [pace.due_s(round(n * 1e9 / 30), 100.0) for n in range(4)]
        np.testing.assert_allclose(due, [100 + n / 30 / speed for n in range(4)], atol=1e-6)
    assert Pace(0).due_s(10**18, 5.0) == 5.0


def test_a_jumping_clock_holds_up_nothing() -> None:
    pace = Pace(1.0)
    due = [pace.due_s(t, 10.0) for t in (0, 10**8, 10**8 - 10**15, 10**15, 10**15 + 10**8)]
    assert due[2] == due[1]
    assert due[3] - due[2] == LONGEST_STEP_S
    assert np.isclose(due[4] - due[3], 0.1)


def test_a_replay_that_was_held_up_does_not_hurry_for_ever() -> None:
    pace = Pace(1.0)
    pace.due_s(0, 0.0)
    assert pace.due_s(10**8, 60.0) == 60.0 - LONGEST_STEP_S


@given(st.lists(st.integers(0, 3), max_size=60), st.integers(1, 6))
def test_never_more_in_flight_than_the_window_and_all_get_done(steps: list[int], size: int) -> None:
    window, seq, done, freed = SendWindow(size), 0, -1, 0
    for now, step in enumerate(steps):
        if window.has_room:
            window.sent(_frame(seq), float(now))
            seq += 1
        done = min(done + step, seq - 1)
        freed += window.done(done, float(now))
        assert window.in_flight == seq - 1 - done <= size
        assert freed == done + 1


def test_what_is_not_done_is_sent_again_in_order_when_nothing_moves() -> None:
    window = SendWindow(3)
    for seq, now in ((5, 0.0), (7, 0.1), (8, 0.2)):
        window.sent(_frame(seq), now)
    assert window.to_resend(1.9) == []
    assert [f.seq for f in window.to_resend(0.2 + RESEND_AFTER_S[1])] == [5, 7, 8]
    assert window.to_resend(3.0) == []
    window.done(5, 3.5)
    assert window.to_resend(7.4) == []
    assert [f.seq for f in window.to_resend(7.6)] == [7, 8]
    assert window.still_s(13.5) == 10.0
    window.done(8, 14.0)
    assert window.to_resend(99.0) == []
    assert window.still_s(99.0) == 0.0


def test_a_slow_link_is_not_filled_with_repeats() -> None:
    """Frames that took 5 s were sent again every 2 s forever: most of a slow link carried repeats."""
    window, now, resent = SendWindow(1), 0.0, []
    for seq in range(8):
        window.sent(_frame(seq), now)
        resent.append(sum(len(window.to_resend(now + 0.1 * tenth)) for tenth in range(50)))
        now += 5.0
        window.done(seq, now)
    assert resent == [1, 1, 0, 0, 0, 0, 0, 0]


def test_what_is_lost_again_and_again_is_sent_again_less_and_less_often() -> None:
    window = SendWindow(1)
    window.sent(_frame(0), 0.0)
    moments = [n for n in range(80) if window.to_resend(float(n))]
    assert moments == [2, 6, 14, 30, 46, 62, 78], "2, 4, 8, then every 16 s"


def test_a_quick_line_is_asked_again_sooner() -> None:
    window, now = SendWindow(1), 0.0
    for seq in range(40):
        window.sent(_frame(seq), now)
        now += 0.02
        window.done(seq, now)
    assert window.resend_after_s == RESEND_AFTER_S[0]


def test_a_camera_that_stood_still_itself_does_not_take_the_line_for_slow() -> None:
    """Frozen for 12 s and cut off by that, it lost the next frame and waited another 10 s to send it again."""
    window, now = SendWindow(1), 0.0
    for seq in range(40):
        window.sent(_frame(seq), now)
        now += 12.0 if seq == 30 else 0.02
        window.done(seq, now)
    assert window.resend_after_s == RESEND_AFTER_S[0]
