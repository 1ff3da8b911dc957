"""Totals: what is seen, what is estimated for belt that was not, and an interval that does not shrink forever."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from aggregator.calibration.correction import (
    CULTIVAR_SD,
    FACTOR_SD,
    LOAD_SD_CHANCES,
    LOAD_SDS,
    OFFSET_SD_MM,
    Prior,
)
from aggregator.calibration.sensitivity import tuber_g_per_mm
from aggregator.calibration.tickets import Ticket
from aggregator.core.load_sums import LoadSums
from aggregator.core.totals import LoadTotals
from conveyor.messages import Tuber
from conveyor.statistics import NORMAL_90

TUBER = Tuber(1, "r", 0, 0, 0, 170.0, 140.0, 200.0, 70, 60, 50, 3, "pointraft", "m", (), ("a",), ("t",))


def load(n: int, **changes: object) -> LoadTotals:
    sums = LoadSums(50.0)
    for i in range(n):
        sums.add(replace(TUBER, crossed_ns=i * 100_000_000, **changes))
    return LoadTotals(sums)


def test_count_weight_and_histogram() -> None:
    sums = LoadSums(50.0)
    for weight_g in (10.0, 49.9, 50.0, 170.0, 99999.0):
        sums.add(replace(TUBER, weight_g=weight_g))
    message = LoadTotals(sums).message("r", coverage=1.0, cameras={"a": "ended"}, final=True)
    assert message.count == 5
    assert message.weight_g == pytest.approx(10 + 49.9 + 50 + 170 + 99999)
    assert (message.histogram[0], message.histogram[1], message.histogram[3], message.histogram[63]) == (2, 1, 1, 1)
    assert sum(message.histogram) == 5


def half_width(totals: LoadTotals) -> float:
    low_g, high_g = totals.interval_g()
    return (high_g - low_g) / 2 / totals.weight_g


def test_random_errors_vanish_with_the_count_and_what_is_not_known_of_the_line_stays() -> None:
    """Before any ticket a load is as wide as offset, factor, cultivar and load make it."""
    per_mm = tuber_g_per_mm(TUBER) / TUBER.weight_g
    shared = NORMAL_90 * math.hypot(
        per_mm * OFFSET_SD_MM, FACTOR_SD, CULTIVAR_SD, math.sqrt(LOAD_SD_CHANCES @ LOAD_SDS**2)
    )
    assert 0.10 < shared < 0.20
    for n in (1, 100, 10_000):
        assert half_width(load(n)) == pytest.approx(math.hypot(shared, 30 / 170 / math.sqrt(n)), rel=1e-6)


def test_a_resting_level_that_is_stated_well_narrows_the_interval() -> None:
    stated = LoadTotals(load(1000).sums, prior=Prior(5.5, offset_sd_mm=0.5))
    assert stated.weight_g == pytest.approx(1000 * TUBER.weight_g)  # it is in the tubers' weights already
    assert half_width(stated) < 0.7 * half_width(load(1000))


def test_the_parts_of_the_interval_add_up_to_it() -> None:
    totals = load(100)
    message = totals.message("r", coverage=0.9, cameras={}, final=False)
    assert set(message.parts_percent) == {"resting level", "camera", "tubers", "belt not seen"}
    assert message.parts_percent["resting level"] == max(message.parts_percent.values())
    whole = 100 * (message.estimated_high_g - message.estimated_low_g) / 2 / message.estimated_weight_g
    assert math.hypot(*message.parts_percent.values()) == pytest.approx(whole, abs=0.05)
    assert message.calibrated_by == ""
    nothing = LoadTotals(LoadSums(50.0)).message("r", coverage=None, cameras={}, final=False)
    assert nothing.parts_percent == {}
    assert (nothing.weight_g, nothing.low_g, nothing.high_g) == (0.0, 0.0, 0.0)
    seen_whole = totals.message("r", coverage=1.0, cameras={}, final=False)
    assert seen_whole.parts_percent["belt not seen"] == pytest.approx(0.0, abs=0.01)


def test_weights_by_volume_widen_the_interval() -> None:
    assert half_width(load(1000, method="volume")) > half_width(load(1000)) + 0.02


def test_full_coverage_estimates_what_was_seen() -> None:
    totals = load(50)
    assert totals.estimated(1.0) == (totals.weight_g, *totals.interval_g())
    assert totals.estimated(None) == (totals.weight_g, *totals.interval_g())


def test_tubers_on_belt_of_which_nothing_is_said_are_not_the_whole_load() -> None:
    """A line stopped with nearly all of its tracks pending said 0 %, and as its estimate what it had counted."""
    totals = load(12)
    seen_g = totals.weight_g
    estimated_g, low_g, high_g = totals.estimated(0.0, belt_m=5.0)
    assert estimated_g == pytest.approx(seen_g * 50)
    assert low_g < estimated_g / 2
    assert high_g > 1.5 * estimated_g
    assert totals.estimated(0.0, belt_m=0.05) == (seen_g, *totals.interval_g())


def test_missed_belt_raises_the_estimate_and_widens_its_interval() -> None:
    totals = load(100)
    low_g, high_g = totals.interval_g()
    weight_g, estimated_low_g, estimated_high_g = totals.estimated(0.8)
    assert weight_g == pytest.approx(totals.weight_g / 0.8)
    assert estimated_high_g - estimated_low_g > (high_g - low_g) / 0.8
    assert estimated_low_g >= low_g


def test_where_no_tuber_was_counted_there_may_have_been_three() -> None:
    """None on 1 % of the belt: by a normal law there were 163 at most, and a line told 26 kg of 41."""
    told_g = [load(n).estimated(0.01)[2] for n in range(4)]
    assert told_g[0] == pytest.approx(-math.log(0.05) * 99 * 172, rel=0.02)
    assert told_g == sorted(told_g)


def test_the_rate_is_that_of_the_last_seconds() -> None:
    assert load(500).message("r", coverage=None, cameras={}, final=False).tubers_per_s == pytest.approx(10.0)
    assert load(1).message("r", coverage=None, cameras={}, final=False).tubers_per_s == 0.0
    sums, last_ns = load(500).sums, max(load(500).sums._recent_ns)
    per_s = [sums.tubers_per_s(last_ns + after_s * 10**9) for after_s in (0, 5, 16)]
    assert per_s == [pytest.approx(10.0), pytest.approx(10.0), 0.0], "a belt that stood for an hour told its last rate"


def test_tickets_scale_the_load_and_narrow_its_interval_but_leave_the_tubers_as_weighed() -> None:
    per_mm_g = 1e6 / TUBER.weight_g * tuber_g_per_mm(TUBER)
    tickets = [Ticket(f"r{n}", "m", 0.9e6, 1000.0, 1e6, 3000.0, 1.0, per_mm_g=per_mm_g) for n in range(5)]
    plain = load(1000)
    calibrated = LoadTotals(plain.sums, tickets)
    message = calibrated.message("r", coverage=1.0, cameras={}, final=False)
    assert message.tickets == 5
    assert message.as_weighed_g == pytest.approx(plain.weight_g)
    assert message.calibrated_by.startswith("5 load tickets: offset ")
    assert message.weight_g == pytest.approx(0.9 * plain.weight_g, rel=0.01)
    assert message.high_g - message.low_g < 0.25 * 0.9 * (plain.interval_g()[1] - plain.interval_g()[0])


def test_tickets_of_other_weights_change_nothing() -> None:
    other = LoadTotals(load(1).sums, [Ticket("r", "other", 0.9e6, 1000.0, 1e6, 3000.0, 1.0)])
    assert other.weight_g == pytest.approx(TUBER.weight_g)
    assert other.message("r", coverage=None, cameras={}, final=False).tickets == 0
