"""Merging: one place is one tuber, one camera's two tracks of the same frames never are, travel without an encoder."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from aggregator.core.matching import one_to_one
from aggregator.core.merge import Gate, PlacedTrack, blocks, merge
from aggregator.core.travel import TravelCurve, common_travel_m
from conveyor.messages import Track
from tests.aggregator.belt_story import tell

GATE = Gate(30.0)
TEMPLATE = next(entry.track for entry in tell(1).logs["cam0"] if entry.track is not None)


def placed(
    camera: str, x_m: float, y_m: float = 0.0, *, seqs: tuple[int, int] = (0, 20), ml: float = 100.0
) -> PlacedTrack:
    name = f"r/{camera}/{seqs[0]}-{round(1e4 * x_m)},{round(1e4 * y_m)}"
    track: Track = replace(TEMPLATE, track_id=name, first_seq=seqs[0], last_seq=seqs[1], visible_volume_ml=ml)
    return PlacedTrack(camera, 1, track, x_m, y_m)


def names(groups: list) -> list[list[str]]:
    return [sorted(f"{m.camera}{m.place_x_m:g}" for m in group.members) for group in groups]


def test_two_cameras_at_one_place_saw_one_tuber() -> None:
    assert names(merge([placed("a", 1.0), placed("b", 1.02, 0.01)], GATE)) == [["a1", "b1.02"]]


def test_beyond_the_gate_there_are_two() -> None:
    assert len(merge([placed("a", 1.0), placed("b", 1.0, 0.031)], GATE)) == 2


def test_one_camera_in_the_same_frames_saw_two_however_near() -> None:
    assert len(merge([placed("a", 1.0), placed("a", 1.001)], GATE)) == 2
    assert len(merge([placed("a", 1.0, seqs=(0, 20)), placed("a", 1.001, seqs=(20, 30))], GATE)) == 2


def test_one_camera_that_restarted_saw_one() -> None:
    assert names(merge([placed("a", 1.0, seqs=(0, 19)), placed("a", 1.01, seqs=(20, 30))], GATE)) == [["a1", "a1.01"]]


def test_two_tubers_that_one_camera_saw_together_are_never_joined_through_another_camera() -> None:
    groups = merge([placed("a", 1.0), placed("a", 1.02), placed("b", 1.01)], GATE)
    assert sorted(len(group.members) for group in groups) == [1, 2]


def test_pairs_are_chosen_together_and_not_one_after_the_other() -> None:
    """Greedy takes (a1, b0.98) first and leaves b1.02 without a partner."""
    tracks = [placed("a", 1.0), placed("a", 0.965), placed("b", 0.982), placed("b", 1.022)]
    assert names(merge(tracks, GATE)) == [["a1", "b1.022"], ["a0.965", "b0.982"]]


def test_size_decides_a_tie_and_nothing_else() -> None:
    tie = [placed("a", 1.0, ml=200), placed("b", 1.01, ml=60), placed("b", 0.99, ml=200)]
    assert ["a1", "b0.99"] in names(merge(tie, GATE))
    clear = [placed("a", 1.0, ml=200), placed("b", 1.005, ml=60), placed("b", 0.98, ml=200)]
    assert ["a1", "b1.005"] in names(merge(clear, GATE))


def test_blocks_part_what_cannot_touch_and_keep_what_can() -> None:
    chain = [placed("a", 1.0), placed("b", 0.98), placed("a", 0.955, 0.3), placed("b", 0.975, 0.3), placed("a", 0.9)]
    parted = blocks(chain, GATE)
    assert [[f"{t.camera}{t.place_x_m:g}" for t in block] for block in parted] == [
        ["a1", "b0.98"],
        ["b0.975", "a0.955"],
        ["a0.9"],
    ]


@pytest.mark.parametrize("seed", range(20))
def test_blocks_one_by_one_give_what_all_at_once_give(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tracks = [
        placed(str(rng.choice(["a", "b", "c"])), float(x), float(y), seqs=(int(s), int(s) + 9))
        for x, y, s in zip(rng.uniform(0, 0.5, 30), rng.uniform(0, 0.3, 30), rng.integers(0, 30, 30), strict=True)
    ]
    whole = names(merge(tracks, GATE))
    parted = [name for block in blocks(tracks, GATE) for name in names(merge(block, GATE))]
    assert sorted(parted) == sorted(whole)
    ends = [(max(t.place_x_m for t in b), min(t.place_x_m for t in b)) for b in blocks(tracks, GATE)]
    assert all(before[1] >= after[0] for before, after in pairwise(ends))


@pytest.mark.parametrize("seed", range(5))
def test_the_order_of_tracks_changes_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tracks = [placed(c, float(x), float(y)) for c in "abc" for x, y in rng.uniform(0, 0.2, (6, 2))]
    shuffled = [tracks[i] for i in rng.permutation(len(tracks))]
    assert names(merge(tracks, GATE)) == names(merge(shuffled, GATE))


def test_the_place_of_a_tuber_counts_each_camera_once() -> None:
    (group,) = merge([placed("a", 1.0, seqs=(0, 9)), placed("a", 1.004, seqs=(10, 19)), placed("b", 1.012, 0.02)], GATE)
    assert group.place_x_m == pytest.approx(1.007)
    assert group.place_y_m == pytest.approx(0.01)


def test_one_to_one_leaves_alone_what_costs_one_or_more() -> None:
    cost = np.array([[0.2, 0.9], [0.1, math.inf], [math.inf, 1.0]])
    assert one_to_one(cost) == [(0, 1), (1, 0)]
    assert one_to_one(np.empty((0, 3))) == []


@pytest.mark.parametrize("seed", range(20))
def test_one_to_one_is_the_cheapest_whether_or_not_there_is_a_choice(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for share in (0.1, 0.3, 0.8):
        cost = np.where(rng.random((5, 4)) < share, rng.random((5, 4)), math.inf)
        assert one_to_one(cost) == cheapest(cost)


def cheapest(cost: np.ndarray) -> list[tuple[int, int]]:
    rows, columns = linear_sum_assignment(np.minimum(cost, 1.0))
    return [(i, j) for i, j in zip(rows.tolist(), columns.tolist(), strict=True) if cost[i, j] < 1.0]


def test_a_live_aggregator_loads_the_solver_before_its_first_choice() -> None:
    """Half a second of every ledger's time otherwise, in the middle of a load."""
    said = "import sys; from aggregator.core import matching; import numpy as np; "
    said += "matching.one_to_one(np.array([[0.1, 2.0], [2.0, 0.1]])); assert 'scipy' not in sys.modules; "
    said += "matching.make_ready(); assert 'scipy.optimize' in sys.modules"
    subprocess.run([sys.executable, "-c", said], check=True, timeout=120)


def curves(**samples: list[tuple[int, float]]) -> dict[str, TravelCurve]:
    found = {}
    for name, points in samples.items():
        found[name] = TravelCurve()
        for t_ns, x_m in points:
            found[name].add(t_ns, x_m)
    return found


def test_the_first_cameras_travel_is_the_lines() -> None:
    both = curves(a=[(0, 0.0), (100, 1.0)], b=[(0, 5.0), (100, 6.1)])
    assert common_travel_m(both, reference="a", camera="b", t_ns=50, own_travel_m=5.55) == pytest.approx(0.5)
    assert common_travel_m(both, reference="a", camera="a", t_ns=50, own_travel_m=0.47) == 0.47


def test_beyond_the_first_cameras_samples_is_waited_for_or_gone_on_with_the_own_travel() -> None:
    both = curves(a=[(0, 0.0), (100, 1.0)], b=[(0, 5.0), (200, 7.2)])
    assert common_travel_m(both, reference="a", camera="b", t_ns=150, own_travel_m=6.65) is None
    both["a"].closed = True
    assert common_travel_m(both, reference="a", camera="b", t_ns=150, own_travel_m=6.65) == pytest.approx(1.55)
    late = curves(a=[(100, 1.0), (200, 2.0)], b=[(0, 5.0), (100, 6.0)])
    assert common_travel_m(late, reference="a", camera="b", t_ns=50, own_travel_m=5.5) == pytest.approx(0.5)


def test_without_any_sample_of_the_first_camera_each_goes_by_its_own() -> None:
    both = curves(a=[], b=[(0, 5.0)])
    assert common_travel_m(both, reference="a", camera="b", t_ns=50, own_travel_m=5.5) is None
    both["a"].closed = True
    assert common_travel_m(both, reference="a", camera="b", t_ns=50, own_travel_m=5.5) == 5.5


def test_a_mark_that_repeats_a_time_adds_no_sample() -> None:
    curve = TravelCurve()
    for t_ns, x_m in ((0, 0.0), (10, 1.0), (10, 1.5), (5, 9.0)):
        curve.add(t_ns, x_m)
    assert (list(curve.times_ns), list(curve.travels_m)) == ([0, 10], [0.0, 1.0])
    assert curve.at(5) == 0.5


def test_a_day_of_samples_takes_no_more_than_an_hour(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lists of every mark's sample grew by 4 MB an hour and live camera on a belt without an encoder."""
    monkeypatch.setattr("aggregator.core.travel.SAMPLES", 100)
    curve = TravelCurve()
    for n in range(10_000):
        curve.add(n, n * n / 1e8)
        assert len(curve.times_ns) == len(curve.travels_m) <= 100
    assert (curve.first_ns, curve.last_ns) == (0, 9999)
    assert [curve.at(n) for n in range(9951, 10_000)] == [n * n / 1e8 for n in range(9951, 10_000)]
    assert curve.at(9800) == pytest.approx(0.9604, abs=1e-3), "coarser, and still there"
