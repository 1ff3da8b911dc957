"""What became of each frame, and how old it was."""

from __future__ import annotations

import pytest

from segmenter.age import FrameAge
from segmenter.balance import FrameBalance


def test_frames_that_the_ring_overwrote_are_drops_and_the_rest_are_gaps() -> None:
    """They were counted as gaps of the link, though we dropped them ourselves."""
    balance = FrameBalance()
    balance.receive(0)
    balance.overwritten(3)
    balance.receive(3)
    balance.receive(4)
    balance.receive(8)
    assert balance.dropped == {"overwritten": 3}
    balance.processed = 4
    assert balance.report() == {"published": 9, "received": 7, "processed": 4, "gaps": 2, "dropped_overwritten": 3}


@pytest.mark.parametrize(("told_first", "early"), [(0, 4), (3, 2), (None, 0), (9, 0)])
def test_what_was_overwritten_before_the_first_frame_is_no_later_gap(told_first: int | None, early: int) -> None:
    """A link that lost frames later was told as a ring that overflowed."""
    balance = FrameBalance()
    balance.known_range(told_first, None)
    balance.overwritten(4)
    balance.receive(5)
    assert balance.dropped.total() == early
    balance.receive(8)
    assert balance.dropped.total() == early


def test_the_age_of_a_frame_is_told_on_the_clock_it_is_sent_by() -> None:
    """At five times real time the camera's clock ran ahead so fast that no frame was ever called old."""
    late_ms = 700.0
    for speed in (1.0, 5.0):
        age = FrameAge(speed)
        for i in range(30):
            captured_ns = i * 33_000_000
            late = late_ms if i == 29 else 0.0
            told_ms = age.age_ms(captured_ns, round(captured_ns / speed + late * 1e6))
        assert told_ms == pytest.approx(late_ms, abs=0.01)
