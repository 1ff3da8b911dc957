"""Rates, growth and belt speed of the operator's page."""

from __future__ import annotations

from dataclasses import replace

import pytest

from conveyor.messages import Travel
from tests.viewer.page_states import counters, totals
from viewer.page.flow import QUIET_S, STEP_S, STEPS, TRAVEL_STALE_S, BeltSpeed, LoadFlow, RateHistory
from viewer.page.growth import PAUSE_S, WINDOW_S, Growth
from viewer.page.state import Flow


def fed(values: list[float], *, name: str = "frames_dropped_blind") -> Growth:
    """A report each second."""
    growth = Growth()
    for second, value in enumerate(values):
        growth.add(counters("segmenter/left", gauges={name: value}), float(second))
    return growth


def test_what_grows_is_told_with_its_time_and_rate() -> None:
    growth = fed([0, 0, 0, 5, 10, 15, 20, 25, 30, 35])
    assert growth.growing_s(9.0) == {"frames_dropped_blind": 6.0}
    assert growth.per_s()["frames_dropped_blind"] == pytest.approx(5.0)
    assert growth.resting_s(9.0) == {"frames_dropped_blind": 0.0}


def test_what_stopped_growing_rests() -> None:
    growth = fed([0, 5, 10, *[10] * 6])
    assert growth.growing_s(8.0) == {}
    assert growth.resting_s(8.0) == {"frames_dropped_blind": 6.0}
    again = fed([0, 5, 10, *[10] * 6, 15])
    assert again.growing_s(9.0) == {"frames_dropped_blind": 0.0}, "a new trouble begins at zero"


def test_a_count_that_was_there_before_the_page_is_no_growth() -> None:
    assert fed([400]).growing_s(0.0) == {}
    assert fed([400, 400, 400]).growing_s(2.0) == {}


def test_a_frame_under_way_is_no_growth() -> None:
    growth = fed([0, 1, 0, 1, 0, 1, 0, 1, 0, 1], name="frames_gaps")
    assert growth.growing_s(9.0) == {}
    assert growth.lowest()["frames_gaps"] == 0


def test_a_restart_or_a_new_run_counts_from_zero() -> None:
    growth = fed([0, 100, 200])
    report = counters("segmenter/left", gauges={"frames_dropped_blind": 3.0})
    growth.add(replace(report, pid=4712), 3.0)
    assert (growth.growing_s(3.0), growth.per_s()) == ({}, {})
    growth.add(replace(report, pid=4712, run="tuesday"), 4.0)
    assert growth.growing_s(4.0) == {}


def test_memory_has_an_end() -> None:
    growth = fed([float(n) for n in range(500)])
    assert len(growth._reports) <= WINDOW_S + 2
    assert PAUSE_S < WINDOW_S


def travel(
    metres: float, second: float, *, source: str = "left", estimated: bool = True, run: str = "monday"
) -> Travel:
    return Travel(source, run, int(second * 1e9), metres, estimated)


def test_belt_speed_is_by_the_cameras_clock() -> None:
    belt = BeltSpeed()
    for n in range(40):  # ten times faster than life
        belt.add(travel(0.042 * n, 0.1 * n), 0.01 * n)
    assert belt.m_per_s(0.4) == pytest.approx(0.42)
    assert belt.m_per_s(0.4 + TRAVEL_STALE_S + 0.1) is None


def test_an_encoder_is_believed_before_an_estimate() -> None:
    belt = BeltSpeed()
    for n in range(10):
        belt.add(travel(0.05 * n, 0.1 * n), n)
        belt.add(travel(0.04 * n, 0.1 * n, source="roller", estimated=False), n)
    assert belt.m_per_s(9.0) == pytest.approx(0.4)


def test_a_new_run_starts_the_belt_anew() -> None:
    belt = BeltSpeed()
    belt.add(travel(10.0, 1.0), 0.0)
    belt.add(travel(0.0, 1.1, run="tuesday"), 0.1)
    assert belt.m_per_s(0.1) is None
    belt.add(travel(0.03, 1.2, run="tuesday"), 0.2)
    assert belt.m_per_s(0.2) == pytest.approx(0.3)


def test_tubers_and_kilograms_a_minute() -> None:
    load = LoadFlow()
    assert load.per_min(0.0) is None
    for n in range(21):
        load.add(totals(count=100 + 10 * n, weight_g=20000.0 + 1500.0 * n, tubers_per_s=10.0), n / 2)
    tubers, kilograms = load.per_min(10.0) or (0, 0)
    assert (tubers, kilograms) == (pytest.approx(600), pytest.approx(600 * 0.150)), "weighed by those that come now"


def test_nothing_comes_any_more() -> None:
    load = LoadFlow()
    load.add(totals(count=100, weight_g=20000.0, tubers_per_s=10.0), 0.0)
    load.add(totals(count=110, weight_g=21500.0, tubers_per_s=10.0), 1.0)
    for second in range(2, 20):
        load.add(totals(count=110, weight_g=21500.0, tubers_per_s=10.0), float(second))
    assert load.per_min(1.0 + QUIET_S + 0.1) == (0.0, 0.0)


def test_a_new_load_does_not_run_backwards() -> None:
    load = LoadFlow()
    load.add(totals(count=5000, weight_g=9e5, tubers_per_s=10.0), 0.0)
    load.add(totals(run="tuesday", count=10, weight_g=2000.0, tubers_per_s=2.0), 1.0)
    assert load.per_min(1.0) == (pytest.approx(120), pytest.approx(24.0))


def test_the_last_ten_minutes_are_means_of_ten_seconds_and_have_holes_where_nothing_is_known() -> None:
    history = RateHistory()
    start_s = 1000.0
    for second in range(1300):
        known = not 700 <= second < 730
        history.add(Flow(60.0, float(second // 10), 0.4) if known else Flow(), start_s + second)
    rate = history.rate(start_s + 1299)
    assert (rate.step_s, len(rate.kg_per_min), len(rate.tubers_per_min)) == (STEP_S, STEPS, STEPS)
    assert rate.kg_per_min[0] is None, "70 s to 73 s of it lie before the hole"
    assert rate.kg_per_min[3:] == tuple(float(n) for n in range(73, 130))
    assert rate.tubers_per_min[-1] == 60.0
    assert history.rate(start_s + 9999).kg_per_min == (None,) * STEPS
