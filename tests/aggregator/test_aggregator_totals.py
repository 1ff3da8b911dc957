"""Totals: what is seen, what is estimated for belt that was not, and an interval that does not shrink for ever."""

from __future__ import annotations

from dataclasses import replace

import pytest

from aggregator.calibration.tickets import Ticket
from aggregator.core.load_sums import LoadSums
from aggregator.core.totals import SHARED_BIAS, LoadTotals
from conveyor.messages import Tuber

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


def test_random_errors_vanish_with_the_count_and_the_shared_bias_stays() -> None:
    for n, spread in ((1, 30 / 170), (100, 0.053), (10_000, SHARED_BIAS["pointraft"])):
        totals = load(n)
        low_g, high_g = totals.interval_g()
        assert (high_g - low_g) / 2 / totals.weight_g == pytest.approx(spread, rel=0.05)


def test_weights_by_volume_widen_the_interval() -> None:
    by_volume, by_network = load(1000, method="volume"), load(1000)
    assert by_volume.interval_g()[1] > 1.04 * by_network.interval_g()[1]


def test_full_coverage_estimates_what_was_seen() -> None:
    totals = load(50)
    assert totals.estimated(1.0) == (totals.weight_g, *totals.interval_g())
    assert totals.estimated(None) == (totals.weight_g, *totals.interval_g())


def test_missed_belt_raises_the_estimate_and_widens_its_interval() -> None:
    totals = load(100)
    low_g, high_g = totals.interval_g()
    weight_g, estimated_low_g, estimated_high_g = totals.estimated(0.8)
    assert weight_g == pytest.approx(totals.weight_g / 0.8)
    assert estimated_high_g - estimated_low_g > (high_g - low_g) / 0.8
    assert estimated_low_g >= low_g


def test_the_rate_is_that_of_the_last_seconds() -> None:
    assert load(500).message("r", coverage=None, cameras={}, final=False).tubers_per_s == pytest.approx(10.0)
    assert load(1).message("r", coverage=None, cameras={}, final=False).tubers_per_s == 0.0


def test_tickets_scale_the_load_and_narrow_its_interval_but_leave_the_tubers_as_weighed() -> None:
    tickets = [Ticket(f"r{n}", "m", 0.9e6, 1000.0, 1e6, 3000.0, 1.0) for n in range(5)]
    plain = load(1000)
    calibrated = LoadTotals(plain.sums, tickets)
    message = calibrated.message("r", coverage=1.0, cameras={}, final=False)
    assert message.tickets == 5
    assert message.as_weighed_g == pytest.approx(plain.weight_g)
    assert message.weight_g == pytest.approx(0.9 * plain.weight_g, rel=0.01)
    assert message.high_g - message.low_g < 0.8 * 0.9 * (plain.interval_g()[1] - plain.interval_g()[0])


def test_tickets_of_other_weights_change_nothing() -> None:
    other = LoadTotals(load(1).sums, [Ticket("r", "other", 0.9e6, 1000.0, 1e6, 3000.0, 1.0)])
    assert other.weight_g == pytest.approx(TUBER.weight_g)
    assert other.message("r", coverage=None, cameras={}, final=False).tickets == 0
