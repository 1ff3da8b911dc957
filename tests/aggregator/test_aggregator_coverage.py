"""Coverage from a load's first metre to its last equals the truth, and the estimate's interval holds the true load."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from aggregator.core.coverage import Moment, coverage
from aggregator.core.lanes import share_seen
from aggregator.core.load_state import load_state
from aggregator.core.load_sums import LoadSums
from aggregator.core.load_told import counted
from aggregator.core.reasons import LoadState, NothingSeen, Unseen
from aggregator.core.sight import PIECES, CameraSight
from aggregator.core.totals import LoadTotals
from conveyor.messages import Mark, Tuber
from conveyor.messages.tracks import UNFOLLOWED
from conveyor.ranges import FASTEST_MPS
from conveyor.statistics import NORMAL_90
from tests.aggregator.looking_story import FPS, START_NS, Outage, look, positions_m, share_of, some_outages

OVER = Moment(over=True)
TUBER = Tuber(1, "r", 0, 0, 0, 170.0, 140.0, 200.0, 70, 60, 50, 3, "pointraft", "m", (), ("a",), ("t",))


@pytest.mark.parametrize("estimated", [False, True])
def test_of_one_camera_it_is_the_truth(estimated: bool, rng: np.random.Generator) -> None:
    for n in range(60):
        belt_m = positions_m(rng, rng.uniform(8, 60), steady=estimated)
        if belt_m[-1] < 1.0:
            continue
        final = bool(rng.random() < 0.5)
        outages = some_outages(rng, len(belt_m) / FPS)
        own = look(belt_m, outages, estimated=estimated, final=final, zero_m=float(rng.uniform(-2, 2)))
        if len(own.sight.curve) < 3:
            continue
        found = coverage({"a": own.sight}, seen_by={frozenset({"a"}): 7}, moment=OVER)
        true = sum(b - a for a, b in own.looked) / belt_m[-1]
        assert found.share == pytest.approx(true, abs=1e-6 if not estimated else 2e-3), (n, outages)
        assert found.belt_m == pytest.approx(belt_m[-1], abs=1e-6 if not estimated else 0.02)
        unseen_m = sum(found.unseen_m["a"].values())
        assert unseen_m == pytest.approx((1 - (found.share or 0.0)) * found.belt_m, abs=1e-6)


LANES = ({"a": 1.0, "b": 1.0}, {"ab": 1.0}, {"a": 0.7, "b": 0.4, "ab": 0.6}, {"a": 0.2, "ab": 1.0})


@pytest.mark.parametrize("estimated", [False, True])
@pytest.mark.parametrize("lanes", LANES, ids=lambda lanes: "+".join(lanes))
def test_of_two_cameras_it_is_the_share_of_tubers_that_passed_under_one(
    lanes: dict[str, float], estimated: bool, rng: np.random.Generator
) -> None:
    """Both slept while the line started, and the product of their shares took that for two accidents."""
    errors, density = [], {frozenset(lane): value for lane, value in lanes.items()}
    while len(errors) < 25:
        belt_m = positions_m(rng, rng.uniform(20, 60), steady=True)
        seconds = len(belt_m) / FPS
        own = {n: look(belt_m, some_outages(rng, seconds), estimated=estimated, final=False) for n in "ab"}
        if any(len(o.sight.curve) < 3 for o in own.values()):
            continue
        cells = {name: share_of(o.looked, belt_m[-1]) for name, o in own.items()}
        if (cells["a"] & cells["b"]).mean() < 0.25:
            continue
        seen_by: dict[frozenset[str], int] = {}
        for at in ({"a"}, {"b"}, {"a", "b"}, set()):
            here = np.mean([cells["a"] if "a" in at else ~cells["a"], cells["b"] if "b" in at else ~cells["b"]], 0) == 1
            for lane, value in density.items():
                group = frozenset(lane & at)
                if group:
                    seen_by[group] = seen_by.get(group, 0) + round(1e6 * value * here.mean())
        true = sum(
            value * np.any([cells[name] for name in lane], axis=0).mean() for lane, value in density.items()
        ) / sum(density.values())
        found = coverage({name: o.sight for name, o in own.items()}, seen_by=seen_by, moment=OVER)
        errors.append((found.share or 0.0) - true)
    assert np.abs(errors).max() < 0.1, errors
    assert np.quantile(np.abs(errors), 0.9) < 0.03, errors
    assert abs(np.mean(errors)) < 0.015


def test_the_interval_of_the_estimate_holds_the_true_load(rng: np.random.Generator) -> None:
    """Loads on an unevenly loaded belt, weights with a bias that all tubers share, cameras that fail now and then."""
    inside, n, partly = 0, 0, 0
    while n < 250:
        belt_m = positions_m(rng, rng.uniform(15, 120), steady=True)
        own = look(belt_m, some_outages(rng, len(belt_m) / FPS), estimated=bool(rng.random() < 0.5), final=False)
        metres = int(np.ceil(belt_m[-1]))
        per_m = rng.gamma(2.0, rng.uniform(2.0, 15.0) / 2.0, metres)
        places = np.concatenate([m + rng.random(rng.poisson(per_m[m])) for m in range(metres)])
        places = places[places < belt_m[-1]]
        true_g = np.clip(rng.normal(172, 90, len(places)), 16, 624)
        seen = np.any([(places >= a) & (places < b) for a, b in own.looked], axis=0) if own.looked else []
        found = coverage({"a": own.sight}, seen_by={frozenset({"a"}): int(np.sum(seen))}, moment=OVER)
        if not found.share or not len(places):
            continue
        bias, sums = rng.normal(1.0, 0.05 / NORMAL_90), LoadSums(50.0)
        for grams in true_g[seen]:
            weighed = float(grams * bias * rng.normal(1.0, 0.08))
            half_g = 0.08 * NORMAL_90 * weighed
            sums.add(replace(TUBER, weight_g=weighed, low_g=weighed - half_g, high_g=weighed + half_g))
        _, low_g, high_g = LoadTotals(sums).estimated(found.share, belt_m=found.belt_m)
        inside += low_g <= true_g.sum() <= high_g
        partly += found.share < 0.95
        n += 1
    assert partly > 125
    assert inside / n >= 0.88, f"{inside} of {n}"


def test_a_slow_start_is_belt_not_seen() -> None:
    """52 of 61 tubers were counted, and the total said that all of the belt was seen."""
    belt_m = np.arange(0, 301) * 0.016
    for estimated in (False, True):
        own = look(belt_m, [Outage(0.0, 12.0)], estimated=estimated, final=True)
        found = coverage({"a": own.sight}, seen_by={frozenset({"a"}): 40}, moment=OVER)
        assert found.share == pytest.approx(1 - 12.0 / 30.0, abs=1e-3)
        assert found.unseen_m["a"] == {Unseen.BEFORE: pytest.approx(12.0 * 0.16, abs=0.01)}


def test_a_segmenter_that_died_is_measured_by_the_encoder_by_the_other_camera_or_by_the_clock() -> None:
    belt_m = np.arange(0, 301) * 0.03
    gone = [Outage(10.0, 1e9)]
    told = look(belt_m, gone, estimated=False, final=False)
    assert coverage({"a": told.sight}, seen_by={}, moment=OVER).share == pytest.approx(9.9 / 30, abs=0.001)
    for estimated in (False, True):
        dead = look(belt_m, gone, estimated=estimated, final=False, told=False)
        well = look(belt_m, [], estimated=estimated, final=False)
        both = coverage({"a": dead.sight, "b": well.sight}, seen_by={}, moment=OVER)
        assert both.cameras == {"a": pytest.approx(9.9 / 30, abs=0.001), "b": pytest.approx(1.0)}
        now_ns = START_NS + 30_000_000_000
        alone = coverage({"a": dead.sight}, seen_by={}, moment=Moment(over=True, until_ns={"a": now_ns}))
        assert alone.share == pytest.approx(9.9 / 30, abs=0.001)
        running = Moment(over=False, away={"a"}, until_ns={"a": now_ns})
        assert coverage({"a": dead.sight}, seen_by={}, moment=running).share == pytest.approx(9.9 / 30, abs=0.001)
        assert coverage({"a": dead.sight}, seen_by={}, moment=Moment(over=False)).share == 1.0


def test_a_live_camera_that_came_late_is_charged_for_the_belt_before_its_first_frame() -> None:
    own = look(np.arange(0, 101) * 0.03, [], estimated=False, final=False).sight
    own.published.live, own.published.lead_s = True, 5.0
    found = coverage({"a": own}, seen_by={}, moment=OVER)
    assert found.share == pytest.approx(3.0 / 4.5, abs=0.001)


def test_a_camera_that_hardly_looked_says_nothing_of_its_lane() -> None:
    """One was stopped after 2 cm of belt: as it had seen no tuber, its lane counted as empty, 60 % for 39 % counted."""
    belt_m = np.arange(0, 301) * 0.015
    right = look(belt_m, [Outage(18.0, 1e9)], estimated=False, final=False).sight
    left = look(belt_m, [Outage(0.2, 1e9)], estimated=False, final=False).sight
    found = coverage({"left": left, "right": right}, seen_by={frozenset({"right"}): 114}, moment=OVER)
    assert found.cameras["right"] == pytest.approx(0.6, abs=0.01)
    assert 0.36 < (found.share or 0.0) < 0.44
    both = look(belt_m, [], estimated=False, final=True).sight  # the same camera, had it looked at all of the belt
    assert coverage({"left": both, "right": both}, seen_by={frozenset({"right"}): 2}, moment=OVER).share == 1.0
    told = coverage({"left": both, "right": right}, seen_by={frozenset({"right"}): 114}, moment=OVER)
    assert told.share == pytest.approx(0.6, abs=0.02)


def test_a_camera_that_never_looked_is_a_lane_of_its_own() -> None:
    well = look(np.arange(0, 101) * 0.03, [], estimated=False, final=True).sight
    never = look(np.arange(0, 101) * 0.03, [Outage(0.0, 1e9)], estimated=False, final=True).sight
    found = coverage({"a": well, "b": never}, seen_by={frozenset({"a"}): 100}, moment=OVER)
    assert found.share == pytest.approx(0.5)
    assert found.unseen_m["b"] == {Unseen.NEVER: pytest.approx(3.0)}
    assert found.mean_unseen_m() == {"camera_never_looked": pytest.approx(1.5)}


def test_recordings_that_begin_a_little_apart_are_seen_whole() -> None:
    belt_m = np.arange(0, 301) * 0.03
    sights = {}
    for name, part in (("a", belt_m), ("b", belt_m[10:] - belt_m[10])):
        sights[name] = look(part, [], estimated=False, final=True, zero_m=0.3 if name == "b" else 0.0).sight
        sights[name].published.waits = True
    assert coverage(sights, seen_by={frozenset("a"): 9, frozenset("b"): 9}, moment=OVER).share == 1.0


def state_of(sights: dict[str, CameraSight], **more: object) -> tuple[LoadState, str]:
    values = {"count": 0, "over": False, "given_up": (), "sheets": {}, **more}
    return load_state(sights, coverage(sights, seen_by={}, moment=OVER), **values)  # type: ignore[arg-type]


def test_no_number_without_sight() -> None:
    well = look(np.arange(0, 101) * 0.03, [], estimated=False, final=False).sight
    assert state_of({"a": well, "b": CameraSight()}) == (LoadState.STARTING, "no frame processed yet of b")
    assert state_of({"a": well}) == (LoadState.COUNTING, "")
    assert state_of({"a": well}, over=True) == (LoadState.ENDED, "")
    assert state_of({"a": CameraSight()}, over=True) == (LoadState.NOTHING_SEEN, "no camera was heard of")
    dropped = {"a": {"published": 30, "received": 30, "processed": 0, "dropped_no_belt": 28, "dropped_too_old": 2}}
    assert state_of({"a": CameraSight()}, over=True, sheets=dropped) == (
        LoadState.NOTHING_SEEN,
        "no belt was found in the frames (28 of 30 frames)",
    )
    assert state_of({"a": CameraSight()}, given_up={"a"})[0] is LoadState.NOTHING_SEEN
    early = look(np.arange(0, 101) * 0.03, [], estimated=False, final=False).sight
    early.complete_ns = START_NS  # stopped before any of it was in a tuber: that is no load of 0 kg
    assert state_of({"a": early}, over=True)[0] is LoadState.NOTHING_SEEN
    still = look(np.zeros(50), [], estimated=False, final=True).sight
    assert state_of({"a": still}, over=True) == (LoadState.NOTHING_SEEN, "the belt did not move")


def test_a_belt_whose_speed_was_never_seen_has_no_coverage_and_an_interval_that_says_so() -> None:
    belt_m = np.arange(0, 101) * 0.03
    lost = look(belt_m, [], estimated=True, final=True).sight
    lost.frames[UNFOLLOWED] = 20_000
    found = coverage({"a": lost}, seen_by={frozenset("a"): 9}, moment=OVER)
    assert (found.share, found.belt_m) == (None, 0.0)
    assert found.most_m == pytest.approx(3.0 + 20.0 * FASTEST_MPS)
    assert state_of({"a": lost}, count=9, over=True) == (LoadState.ENDED, NothingSeen.NO_SPEED)
    assert state_of({"a": lost}, count=9) == (LoadState.COUNTING, NothingSeen.NO_SPEED)
    assert state_of({"a": lost}, over=True) == (LoadState.NOTHING_SEEN, NothingSeen.NO_SPEED)
    sums = LoadSums(50.0)
    for _ in range(9):
        sums.add(TUBER)
    totals = LoadTotals(sums)
    weight_g, low_g, high_g = totals.estimated(found.share, most_m=found.most_m)
    assert (weight_g, low_g) == totals.estimated(None)[:2]
    assert high_g > 9 * TUBER.weight_g * 63 / 0.9  # it may be that only the belt under these nine was looked at

    well = look(belt_m, [], estimated=False, final=True).sight
    both = coverage({"a": lost, "b": well}, seen_by={frozenset("b"): 9}, moment=OVER)
    assert (both.cameras, both.most_m) == ({"a": 0.0, "b": 1.0}, None)
    load = counted([(sums, both), (sums, found)])
    assert (load.coverage, load.most_m) == (None, pytest.approx(both.belt_m + 63.0))


def test_a_restarted_segmenter_takes_back_what_it_had_not_logged() -> None:
    sight = CameraSight()

    def mark(s: float, looked: float, t: int) -> None:
        sight.marked(Mark(START_NS + t * 10**9, s, False, START_NS, -s, False, looked, s, {"processed": 9}, {}, {}))

    for at in range(11):
        mark(0.5 * at, 0.5 * at, at)
    assert (sight.length_m, sight.looked_at_m) == pytest.approx((5.0, 5.0))
    mark(4.7, 4.7, 11)
    assert (sight.length_m, sight.looked_at_m) == pytest.approx((4.7, 4.7))
    mark(7.0, 4.9, 12)
    assert (sight.length_m, sight.looked_at_m) == pytest.approx((7.0, 4.9))
    mark(0.0, 0.0, 13)  # a replay that began again
    assert (sight.length_m, sight.looked_at_m) == (0.0, 0.0)


def test_histories_are_bounded_and_kept_with_every_digit(rng: np.random.Generator) -> None:
    sight, s, looked = CameraSight(), 0.0, 0.0
    for at in range(5000):
        s, looked = s + 0.5, looked + rng.uniform(0.2, 0.5)
        sight.marked(Mark(START_NS + at * 10**9, s, False, START_NS, -s, False, looked, s, {"processed": at}, {}, {}))
    assert len(sight.pieces) <= PIECES
    assert (sight.length_m, sight.looked_at_m) == pytest.approx((s, looked))
    assert CameraSight.from_plain(sight.plain()) == sight
    assert sight.speed_mps(first=False) == pytest.approx(0.5)


def test_without_tubers_the_cameras_shares_are_averaged_and_without_travel_nothing_is_known() -> None:
    lengths = {frozenset("ab"): 1.0, frozenset("a"): 1.0}
    assert share_seen(lengths, belt_m=2.0, shares={"a": 1.0, "b": 0.5}, seen_by={}) == pytest.approx(0.75)
    assert coverage({"a": CameraSight(), "b": CameraSight()}, seen_by={}, moment=OVER).share is None
