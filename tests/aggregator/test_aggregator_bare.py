"""A line without an encoder whose first camera sees bare belt while that stands: another camera knows better."""

from __future__ import annotations

from pathlib import Path

import pytest

from aggregator.core.coverage import Moment, coverage
from aggregator.core.travel import LineTravel, TravelCurve
from aggregator.ledger.writer import Ledger
from tests.aggregator.belt_story import SPEED_MPS, Stop, Story, tell
from tests.aggregator.virtual_line import Aggregator, fresh_run, undisturbed


def told_with_a_stop(seed: int) -> Story:
    """Two or three cameras along the belt; it stands for a second or two on its way, and the first one sees none of the
    load then.
    """
    stop = Stop(at_s=2.2 + 0.3 * (seed % 5), for_s=1.0 + 0.4 * (seed % 3))
    return tell(seed, cameras=2 + seed % 2, estimated=True, spread_m=0.7, length_m=2.0, n=30, split=0.0, stop=stop)


@pytest.mark.parametrize("seed", range(6))
def test_tubers_are_counted_once_and_all_belt_is_seen(seed: int, tmp_path: Path) -> None:
    told = told_with_a_stop(seed)
    with Ledger(tmp_path / "ledger.db") as ledger:
        calm = undisturbed(ledger, told)
        assert len(calm.tubers()) == len(told.seen())
        assert calm.core.cameras.travel.turns
        sums = ledger.sums(calm.story.run)
        seen = coverage(sums.sights, seen_by=sums.load.seen_by, moment=Moment(over=True))
        assert seen.share == 1.0
        assert seen.belt_m == pytest.approx(SPEED_MPS * ((2.0 + 0.3) / SPEED_MPS + 1.2), rel=0.03)
        ahead = told.names[seed % len(told.names)]
        it = Aggregator(ledger, told.in_run(fresh_run("bare")))
        for n in range(1, len(told.logs[ahead]) + 1):
            it.receive(ahead, n)
        it.commit()
        for n in it.commits():
            if n % (1, 5)[seed % 2] == 0:
                it.start()  # from the ledger alone
        it.deliver_the_rest()
        assert it.core.finished
        assert it.canonical() == calm.canonical()


def curve(*samples: tuple[int, float, int], closed: bool = False) -> TravelCurve:
    """Samples (milliseconds, metres, milliseconds carried on)."""
    made = TravelCurve(closed=closed)
    for at_ms, travel_m, carried_ms in samples:
        made.add(at_ms * 1_000_000, travel_m, carried_ms)
    return made


def line(*curves: TravelCurve) -> LineTravel:
    return LineTravel(dict(zip("abc", curves, strict=False)), head_start_m=0.0)


def at(of: LineTravel, camera: str, at_ms: int, own_m: float) -> float | None:
    of.follow()
    return of.travel_m(camera, t_ns=at_ms * 1_000_000, own_travel_m=own_m)


def test_over_a_stretch_that_the_first_camera_did_not_see_the_best_one_tells_the_travel() -> None:
    first = curve((0, 0.0, 0), (1000, 0.3, 0), (2000, 0.6, 1000), (3000, 0.9, 1000))
    half = curve((0, 5.0, 0), (1000, 5.3, 0), (2000, 5.5, 500), (3000, 5.8, 500))
    stood = curve((0, 7.0, 0), (1000, 7.3, 0), (1500, 7.4, 0), (3000, 7.7, 0))
    of = line(first, half, stood)
    assert at(of, "a", 1000, 0.3) == pytest.approx(0.3)
    assert at(of, "b", 1500, 5.4) == pytest.approx(0.4), "between two marks of the first one the third one's are taken"
    assert at(of, "a", 2000, 0.6) == pytest.approx(0.5)
    assert at(of, "c", 2500, 7.6) == pytest.approx(0.65), "the first one's own steps from there on"
    assert at(of, "a", 3000, 0.9) == pytest.approx(0.8)
    kept = of.known
    again = line(first, half, stood)
    again.restored(kept)
    assert at(again, "a", 3000, 0.9) == at(of, "a", 3000, 0.9)
    assert again.known == kept, "what is followed again turns nothing twice"


def test_a_speed_that_was_told_late_is_no_leap_of_the_belt() -> None:
    """Bare belt for two seconds, of which the first camera tells 0.6 m at once when it has seen its speed."""
    first = curve((0, 0.0, 0), (2000, 0.0, 2000), (2100, 0.63, 4000), (3000, 0.9, 4000))
    second = curve((0, 1.0, 0), (3000, 1.9, 0))
    of = line(first, second)
    assert [at(of, "b", ms, 1.0 + 0.0003 * ms) for ms in (1000, 2000, 2100, 3000)] == pytest.approx(
        [0.3, 0.6, 0.63, 0.9]
    )


def test_what_no_camera_saw_is_as_the_first_one_has_it() -> None:
    both = line(curve((0, 0.0, 0), (1000, 0.3, 900)), curve((0, 1.0, 0), (1000, 1.5, 900)))
    assert at(both, "b", 1000, 1.5) == pytest.approx(0.3)
    assert not both.turns


def test_a_place_waits_for_the_cameras_that_may_know_better() -> None:
    first, second = curve((0, 0.0, 0), (1000, 0.3, 0), (2000, 0.6, 1000)), curve((0, 5.0, 0), (1500, 5.4, 0))
    of = line(first, second)
    assert at(of, "a", 900, 0.27) == pytest.approx(0.27)
    assert at(of, "a", 1400, 0.42) is None
    assert of.travel_m("a", t_ns=1_400_000_000, own_travel_m=0.42, wait=False) == pytest.approx(0.42)
    second.add(2_000_000_000, 5.4, 0)
    assert at(of, "a", 1400, 0.42) == pytest.approx(0.3 + 0.8 * 0.4 / 3)
    assert at(of, "b", 1750, 5.4) == pytest.approx(0.3 + 0.4 / 3)


def test_no_one_waits_for_a_camera_that_is_silent_or_on_another_clock() -> None:
    first = curve((100_000, 0.0, 0), (101_000, 0.3, 1000))
    assert at(line(first, curve()), "a", 101_000, 0.3) is None
    assert at(line(first, curve(closed=True)), "a", 101_000, 0.3) == pytest.approx(0.3)
    assert at(line(first, curve((5000, 0.0, 0))), "a", 101_000, 0.3) == pytest.approx(0.3)
