"""Which travel a frame gets: clocks that differ and step, words that come late, an encoder that falls silent."""

from __future__ import annotations

import numpy as np
import pytest

from camera_sim.stamps import SILENT_NS, SURE_AFTER, Known, TravelStamps

MS = 1_000_000
DAY_NS = 1_790_000_000_000_000_000
SPEED_MPS = 0.5
"""The belt starts at the monotonic time 0."""


def heard(stamps: TravelStamps, at_ms: range, *, encoder_ahead_ns: int = DAY_NS, late_ms: float = 1.0) -> None:
    """The encoder tells the belt's travel each 20 ms, and is heard so much later."""
    for ms in at_ms:
        stamps.told(ms * MS + encoder_ahead_ns, SPEED_MPS * ms / 1000, round((ms + late_ms) * MS))


@pytest.mark.parametrize("encoder_ahead_s", [0, 3600, -86400])
def test_a_frame_gets_the_travel_of_the_moment_it_was_taken(encoder_ahead_s: int) -> None:
    stamps = TravelStamps()
    heard(stamps, range(0, 1000, 20), encoder_ahead_ns=DAY_NS + encoder_ahead_s * 10**9, late_ms=0.0)
    for taken_ms, now_ms in ((500, 552), (507, 660), (933, 985)):
        taken_ns = stamps.taken_ns(DAY_NS + taken_ms * MS, day_ns=DAY_NS + now_ms * MS, now_ns=now_ms * MS)
        assert taken_ns == taken_ms * MS
        assert stamps.at(taken_ns, now_ms * MS) == pytest.approx(SPEED_MPS * taken_ms / 1000)


def test_words_that_come_late_lay_it_by_their_quickest() -> None:
    stamps = TravelStamps()
    rng = np.random.default_rng(5)
    for ms in range(0, 3000, 20):
        stamps.told(ms * MS, SPEED_MPS * ms / 1000, round((ms + rng.exponential(8.0)) * MS))
    assert stamps.at(2500 * MS, 3000 * MS) == pytest.approx(SPEED_MPS * 2.5, abs=0.0005)


def test_a_moment_beyond_the_newest_word_is_not_known_yet_or_never() -> None:
    stamps = TravelStamps()
    assert stamps.at(0, 10 * MS) is Known.NEVER, "nothing was ever told"
    heard(stamps, range(0, 1000, 20), late_ms=0.0)
    assert stamps.at(990 * MS, 1000 * MS) is Known.NOT_YET
    assert stamps.at(990 * MS, 980 * MS + SILENT_NS) is Known.NEVER, "it is silent"
    assert stamps.at(-5 * MS, 1000 * MS) is Known.NEVER, "before its first word"
    assert stamps.at(0, 1000 * MS) == 0.0


def test_a_gap_between_two_words_is_no_line() -> None:
    """A belt may have stopped and started in it."""
    stamps = TravelStamps()
    heard(stamps, range(0, 1000, 20), late_ms=0.0)
    heard(stamps, range(1800, 2000, 20), late_ms=0.0)
    assert stamps.at(1400 * MS, 2000 * MS) is Known.NEVER
    assert stamps.at(1900 * MS, 2000 * MS) == pytest.approx(0.95)


def test_an_encoder_that_starts_again_by_another_clock_is_believed_at_once() -> None:
    stamps = TravelStamps()
    heard(stamps, range(0, 1000, 20), late_ms=0.0)
    heard(stamps, range(1500, 2000, 20), encoder_ahead_ns=DAY_NS + 7200 * 10**9, late_ms=0.0)
    assert stamps.at(1750 * MS, 2000 * MS) == pytest.approx(0.875)
    assert stamps.at(900 * MS, 2000 * MS) is Known.NEVER, "what it told before is of another time"


@pytest.mark.parametrize("ahead_s", [-0.5, 0.4, 3600.0, -7200.0])
def test_a_camera_by_another_clock_is_laid_by_its_quickest_frame(ahead_s: float) -> None:
    """Its places lie behind by what the belt moved until then: 40 ms here, whatever its clock says."""
    stamps = TravelStamps()
    heard(stamps, range(0, 3000, 20), late_ms=0.0)
    rng = np.random.default_rng(3)
    for n, taken_ms in enumerate(range(100, 2000, 66)):
        now_ms = taken_ms + 40 + float(rng.exponential(10.0))
        captured_ns = DAY_NS + taken_ms * MS + round(ahead_s * 1e9)
        now_ns = round(now_ms * MS)
        taken_ns = stamps.taken_ns(captured_ns, day_ns=DAY_NS + now_ns, now_ns=now_ns)
        assert (taken_ns is None) is (n < SURE_AFTER - 1), "it may be ours, and these frames have waited"
        assert stamps.foreign is (n >= SURE_AFTER - 1)
    assert taken_ns == pytest.approx((taken_ms + 40) * MS, abs=3 * MS)


def test_one_frame_that_waited_does_not_make_a_camera_foreign() -> None:
    stamps = TravelStamps()
    for taken_ms, waited_ms in ((0, 50), (66, 4000), (4100, 45)):
        now_ns = (taken_ms + waited_ms) * MS
        taken_ns = stamps.taken_ns(DAY_NS + taken_ms * MS, day_ns=DAY_NS + now_ns, now_ns=now_ns)
        assert not stamps.foreign
        assert taken_ns == (taken_ms * MS if waited_ms < 1000 else None)


def test_a_step_of_this_machines_clock_moves_nothing() -> None:
    """The camera's driver stamps with it: both step together."""
    stamps = TravelStamps()
    for n in range(40):
        day_ns = DAY_NS + (3600 * 10**9 if n >= 20 else 0)
        taken_ns = stamps.taken_ns(day_ns + n * 66 * MS, day_ns=day_ns + (n * 66 + 30) * MS, now_ns=(n * 66 + 30) * MS)
        assert taken_ns == n * 66 * MS
        assert not stamps.foreign
