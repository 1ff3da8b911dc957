"""Score: matching one to one, what doubles and false ones are, alignment of estimated travel, truth that is refused."""

from __future__ import annotations

import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aggregator.scoring.align import align
from aggregator.scoring.classes import true_percents
from aggregator.scoring.score import Score, score_run, score_tubers
from aggregator.scoring.truth import TrueTuber, read_truth
from conveyor.contract import Contract, SizeClass
from conveyor.errors import InputError, LedgerError
from conveyor.messages import Tuber
from tests.aggregator.belt_story import scatter

TUBER = Tuber(1, "r", 0, 0, 0, 170.0, 140.0, 200.0, 70, 60, 50, 3, "pointraft", "m", (), ("a",), ("t",))


def counted(places: list[tuple[float, float]], weight_g: float = 110.0) -> list[Tuber]:
    return [
        replace(TUBER, tuber_id=i, place_x_m=x, place_y_m=y, weight_g=weight_g)
        for i, (x, y) in enumerate(places, start=1)
    ]


def truth(places: list[tuple[float, float]], weight_g: float = 100.0, length_mm: float = 80.0) -> list[TrueTuber]:
    return [TrueTuber(f"t{i}", x, y, weight_g, length_mm) for i, (x, y) in enumerate(places)]


def score(tubers: list[Tuber], true: list[TrueTuber], *, estimated: bool = False, match_mm: float = 25.0) -> Score:
    return score_tubers(tubers, true, match_mm=match_mm, travel_estimated=estimated, coverage=None)


def test_a_perfect_count_and_the_errors_of_its_weights() -> None:
    places = [(0.0, 0.0), (-0.1, 0.05), (-0.2, 0.0)]
    result = score(counted([(x + 0.003, y + 0.004) for x, y in places]), truth(places))
    assert (result.missed, result.double_counted, result.false, result.matched) == (0, 0, 0, 3)
    assert (result.mae_g, result.rmse_g, result.bias_g) == pytest.approx((10, 10, 10))
    assert result.weight_error_percent == pytest.approx(10)
    assert result.place_mean_mm == pytest.approx(5)
    assert result.count_error_percent == 0


def test_missed_double_and_false() -> None:
    true = truth([(0.0, 0.0), (-0.2, 0.0), (-0.4, 0.0)])
    result = score(counted([(0.002, 0.0), (-0.02, 0.0), (-0.2, 0.001), (-0.6, 0.1)]), true)
    assert (result.missed, result.double_counted, result.false) == (1, 1, 1)
    assert result.missed_ids == ("t2",)
    assert result.double_ids == (2,)
    assert result.false_ids == (4,)
    assert result.count == result.matched + result.double_counted + result.false
    assert result.true_count == result.matched + result.missed


def test_the_other_end_of_a_split_tuber_is_a_double() -> None:
    result = score(counted([(0.0, 0.0), (-0.038, 0.0)]), truth([(0.0, 0.0)], length_mm=80))
    assert (result.double_counted, result.false) == (1, 0)


def test_neighbours_are_matched_together_and_not_greedily() -> None:
    true = truth([(0.0, 0.0), (-0.03, 0.0)])
    result = score(counted([(-0.016, 0.0), (-0.05, 0.0)]), true)
    assert (result.matched, result.missed) == (2, 0)


@pytest.mark.parametrize("seed", range(8))
def test_estimated_travel_is_aligned(seed: int) -> None:
    """Another zero, 1 % of drift, 10 % missed, 5 % false: still the right matches, and the alignment is reported."""
    rng = np.random.default_rng(seed)
    true = scatter(rng, 60, apart_m=0.06, length_m=4.0)
    scale, offset_m = 1 + rng.uniform(-0.01, 0.01), rng.uniform(-2, 2)
    seen = [t for t in true if rng.random() > 0.1]
    places = [((t.x_m - offset_m) / scale + rng.normal(0, 0.003), t.y_m + rng.normal(0, 0.003)) for t in seen] + [
        (float(rng.uniform(-4, 0)) - offset_m, float(rng.uniform(-0.2, 0.2))) for _ in range(3)
    ]
    result = score(counted(places), truth([(t.x_m, t.y_m) for t in true]), estimated=True)
    assert result.aligned
    assert result.scale == pytest.approx(scale, abs=0.002)
    assert result.offset_mm == pytest.approx(1000 * offset_m, abs=8)
    assert result.missed <= len(true) - len(seen)
    assert result.matched >= len(seen)


def test_alignment_of_next_to_nothing_is_none() -> None:
    found = align(np.array([[0.0, 0.0]]), np.array([[1.0, 0.5]]), gate_m=0.025)
    assert (found.scale, found.offset_m) == (1.0, 0.0)


def test_nothing_matched_is_said_and_not_divided_by() -> None:
    result = score([], truth([(0.0, 0.0)]))
    assert (result.missed, result.count, result.mae_g) == (1, 0, None)
    assert result.count_error_percent == -100
    json.dumps(result.as_dict(), allow_nan=False)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "is not JSON"),
        ("[]", "no list 'tubers'"),
        ('{"tubers": [3]}', r"tubers\[0\] is int"),
        ('{"tubers": [{"id": 1, "weight_g": 5, "place_x_m": 0}]}', "needs 'place_y_m'"),
        ('{"tubers": [{"id": 1, "weight_g": "5", "place_x_m": 0, "place_y_m": 0}]}', "needs 'weight_g'"),
        ('{"tubers": [{"id": 1, "weight_g": -5, "place_x_m": 0, "place_y_m": 0}]}', "at least 0; got -5"),
        ('{"tubers": [{"weight_g": 5}]}', "needs 'id'"),
        ('{"tubers": [{"id": 1, "weight_g": NaN, "place_x_m": 0, "place_y_m": 0}]}', "needs 'weight_g'"),
    ],
)
def test_truth_that_cannot_be_used_names_the_key(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "truth.json"
    path.write_text(text)
    with pytest.raises(InputError, match=said):
        score_run(tmp_path, truth=path)


def test_further_keys_are_allowed(tmp_path: Path) -> None:
    path = tmp_path / "truth.json"
    path.write_text(
        '{"tubers": [{"id": 1, "weight_g": 5, "place_x_m": 0, "place_y_m": 0, "kind": "x"}], "distractors": 3}'
    )
    assert read_truth(path) == [TrueTuber("1", 0.0, 0.0, 5.0, 0.0)]


def test_a_truth_with_a_byte_order_mark_is_read(tmp_path: Path) -> None:
    """All other text files of a recording might begin with one; this was refused as no JSON."""
    path = tmp_path / "truth.json"
    tubers = [{"id": 1, "place_x_m": 0, "place_y_m": 0, "weight_g": 5, "length_mm": 60}]
    path.write_text(json.dumps({"tubers": tubers}), encoding="utf-8-sig")
    assert read_truth(path) == [TrueTuber("1", 0.0, 0.0, 5.0, 60.0)]
    contract = Contract(measure="length", classes=(SizeClass(name="all"),))
    assert true_percents(path, contract) == [100.0]


def test_a_folder_without_a_ledger_is_named(tmp_path: Path) -> None:
    path = tmp_path / "truth.json"
    path.write_text('{"tubers": [{"id": 1, "weight_g": 5, "place_x_m": 0, "place_y_m": 0}]}')
    with pytest.raises(LedgerError, match=r"no ledger at .*ledger\.db"):
        score_run(tmp_path, truth=path)
    with pytest.raises(InputError, match="--match-mm 0"):
        score_run(tmp_path, truth=path, match_mm=0)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["tubers", "id", "weight_g", "place_x_m", "place_y_m"]), inner, max_size=5)
    ),
)


@given(JSON | JSON.map(lambda value: {"tubers": value if isinstance(value, list) else [value]}))
def test_any_truth_is_read_or_refused_in_words(value: object) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "truth.json"
        path.write_text(json.dumps(value))
        try:
            tubers = read_truth(path)
        except InputError as error:
            assert str(path) in str(error)  # noqa: PT017 - a value is fine too
        else:
            assert all(np.isfinite([t.place_x_m, t.place_y_m, t.weight_g]).all() for t in tubers)
