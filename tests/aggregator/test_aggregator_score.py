"""Score: matching one to one, what doubles and false ones are, alignment of estimated travel, truth that is refused."""

from __future__ import annotations

import json
import tempfile
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from aggregator.ledger.at_rest import order_at_rest
from aggregator.ledger.totals_by import totals_by
from aggregator.ledger.writer import Ledger
from aggregator.report import Reporter
from aggregator.scoring.align import align
from aggregator.scoring.classes import true_percents
from aggregator.scoring.score import Score, score_run, score_tubers
from aggregator.scoring.truth import TrueTuber, read_truth
from conveyor.config import LineConfig
from conveyor.contract import Contract, SizeClass
from conveyor.counters import CounterSet
from conveyor.errors import InputError, LedgerError
from conveyor.messages import LoadOrder, TrackEntry, Tuber
from tests.aggregator.belt_story import scatter, tell
from tests.aggregator.loaded_story import Loads
from tuberline.cli.report import print_score
from tuberline.cli.score import score as score_command

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


def test_places_that_lie_far_apart_are_scored_all_the_same() -> None:
    """Two cameras without travel, one's clock from 0: bins over 500,000 km of belt took 378 GiB, and a traceback."""
    places = [(0.0, 0.0), (-0.1, 0.05), (-0.2, 0.0)]
    result = score(counted([*places, (-5e8, 0.0)]), truth(places), estimated=True)
    assert (result.matched, result.missed, result.false) == (3, 0, 1)


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
        ('{"tubers": [{"id": true, "weight_g": 5}]}', "needs 'id'"),
        ('{"tubers": [{"id": 1, "weight_g": null, "place_x_m": 0, "place_y_m": 0}]}', "needs 'weight_g'.*; got None"),
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
        '{"tubers": [{"id": 1.0, "weight_g": 5, "place_x_m": 0, "place_y_m": 0, "kind": "x"}], "distractors": 3}'
    )
    assert read_truth(path) == [TrueTuber("1", 0.0, 0.0, 5.0, 0.0)]
    path.write_text('{"tubers": [{"id": 1, "weight_g": 5, "place_x_m": 0, "place_y_m": 0, "length_mm": null}]}')
    assert read_truth(path) == [TrueTuber("1", 0.0, 0.0, 5.0, 0.0)], "an unknown length is as good as none"


def test_a_truth_with_a_byte_order_mark_is_read(tmp_path: Path) -> None:
    """All other text files of a recording might begin with one; this was refused as no JSON."""
    path = tmp_path / "truth.json"
    tubers = [{"id": 1, "place_x_m": 0, "place_y_m": 0, "weight_g": 5, "length_mm": 60}]
    path.write_text(json.dumps({"tubers": tubers}), encoding="utf-8-sig")
    contract = Contract(measure="length", classes=(SizeClass(name="all"),))
    for named in (path, tmp_path):
        assert read_truth(named) == [TrueTuber("1", 0.0, 0.0, 5.0, 60.0)], "of a folder its truth.json"
        assert true_percents(named, contract) == [100.0]


def test_a_folder_without_a_ledger_is_named(tmp_path: Path) -> None:
    path = tmp_path / "truth.json"
    path.write_text('{"tubers": [{"id": 1, "weight_g": 5, "place_x_m": 0, "place_y_m": 0}]}')
    with pytest.raises(LedgerError, match=r"no ledger at .*ledger\.db"):
        score_run(tmp_path, truth=path)
    with pytest.raises(InputError, match="--match-mm 0"):
        score_run(tmp_path, truth=path, match_mm=0)


def badly_seen(entry: TrackEntry) -> TrackEntry:
    return (
        entry
        if entry.mark is None
        else replace(entry, mark=replace(entry.mark, looked_at_m=0.4 * entry.mark.travelled_m))
    )


def write_badly_seen(folder: Path, *, loads: bool) -> Path:
    """A run whose cameras each saw 40 % of the belt, with its summary; returns the truth beside it."""
    story = tell(5, n=60, cameras=2, length_m=5.0, noise_mm=0.0)
    story = replace(story, logs={camera: [badly_seen(entry) for entry in log] for camera, log in story.logs.items()})
    with Ledger(folder / "ledger.db") as ledger:
        it = Loads(ledger, story)
        for n in it.commits():
            if loads and n in (1, 5):
                name, x_m = {1: ("A", 0.5), 5: ("B", -2.8)}[n]
                it.order(name, "start", x_m=x_m, fields={"name": name, "variety": {"A": "Agria", "B": "Fontane"}[name]})
        summary = Reporter(ledger, it.core, config=LineConfig(), counters=CounterSet()).summary_text(it.now_s)
        ledger.finish(story.run, summary, sights=it.core.cameras.sights)
    tubers = [
        {"id": str(n), "place_x_m": t.x_m, "place_y_m": t.y_m, "weight_g": 150} for n, t in enumerate(story.tubers)
    ]
    (folder / "truth.json").write_text(json.dumps({"tubers": tubers}))
    (folder / "summary.json").write_text(summary)
    return folder / "truth.json"


@pytest.mark.parametrize("loads", [False, True])
def test_a_run_is_scored_by_the_numbers_that_it_was_told_with(tmp_path: Path, loads: bool) -> None:
    """The interval of the estimate left out that belt is not loaded evenly: it was narrower than the summary's. Loads
    were taken for one: what was missed under each, and the variety of each, was one error in all of them.
    """
    truth_file = write_badly_seen(tmp_path, loads=loads)
    result = score_run(tmp_path, truth=truth_file)
    told = json.loads((tmp_path / "summary.json").read_text())["totals"]
    assert result.coverage is not None
    assert result.coverage < 0.8
    names = ("weight_g", "low_g", "high_g", "estimated_weight_g", "estimated_low_g", "estimated_high_g", "coverage")
    assert {name: getattr(result, name) for name in names} == {name: pytest.approx(told[name]) for name in names}
    whole = totals_by([tmp_path], "load")[0][-1].sums
    estimated = result.estimated_weight_g, result.estimated_low_g, result.estimated_high_g
    assert estimated == pytest.approx((whole.estimated_g, whole.low_g, whole.high_g))
    assert result.as_dict()["calibrated_weight_g"] is None
    assert result.as_dict()["calibrated_error_percent"] is None


def test_the_calibrated_weight_stands_beside_the_raw_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Tickets were ignored without a word: the ledger told another weight."""
    truth_file = write_badly_seen(tmp_path, loads=True)
    before = score_run(tmp_path, truth=truth_file)
    score_command(tmp_path, truth=truth_file)
    assert "no ticket calibrates this run" in capsys.readouterr().out
    (tmp_path / "line.toml").write_text('[cameras.front]\npath = "r"\n[aggregator]\ntickets = "tickets.json"\n')
    earlier = {"run": "monday", "model": "m", "ticket_g": 10000.0, "ticket_sd_g": 20.0, "estimated_g": 9000.0,
               "estimated_sd_g": 90.0, "coverage": 1.0}  # fmt: skip
    (tmp_path / "tickets.json").write_text(json.dumps({"format": 1, "tickets": [earlier]}))
    refused = order_at_rest(tmp_path / "ledger.db", LoadOrder("t", "ticket", load="A", kg=6.0))
    assert "does not calibrate" in refused.text, "too little of its belt was seen"
    after = score_run(tmp_path, truth=truth_file)
    assert before == replace(
        after, calibrated_weight_g=None, calibrated_low_g=None, calibrated_high_g=None, calibrated_by=""
    )
    whole = totals_by([tmp_path], "load")[0][-1].sums
    calibrated = after.calibrated_weight_g, after.calibrated_low_g, after.calibrated_high_g
    assert calibrated == pytest.approx((whole.estimated_g, whole.low_g, whole.high_g)), "as `ledger totals` has it"
    assert after.calibrated_weight_g is not None
    assert after.calibrated_weight_g > 1.04 * after.estimated_weight_g
    assert after.calibrated_by.startswith("1 load ticket: offset")
    assert after.calibrated_error_percent == pytest.approx(100 * (after.calibrated_weight_g / after.true_weight_g - 1))
    score_command(tmp_path, truth=truth_file)
    said = capsys.readouterr().out
    for part in ("load as seen, raw", "load as estimated, raw", f"{after.calibrated_weight_g / 1000:.3f} kg"):
        assert part in said


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


@pytest.mark.parametrize("looked", [True, False])
def test_a_run_that_counted_nothing_has_no_weight(
    looked: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It had 0.000 kg, 90 %: 0.000 to 0.000, as if an empty scale had been read."""
    bare = tell(5, n=0, cameras=1, length_m=2.0)
    with Ledger(tmp_path / "ledger.db") as ledger:
        if looked:
            it = Loads(ledger, bare)
            it.commit_one_by_one()
        else:
            ledger.open_run(bare.run, line="t", cameras=bare.names, version="1", started_ns=0)
    tubers = [{"id": "1", "place_x_m": 0, "place_y_m": 0, "weight_g": 150, "square_mesh_mm": 60}]
    (truth_file := tmp_path / "truth.json").write_text(json.dumps({"tubers": tubers}))
    (contract := tmp_path / "contract.toml").write_text('[[classes]]\nname = "all"\n')
    score_command(tmp_path, truth=truth_file, contract=contract)
    said = " ".join(capsys.readouterr().out.replace("│", " ").split())
    unseen = "no camera saw a belt move; `tuberline audit` says what became of its frames"
    seen = "its belt was seen" if looked else unseen
    assert f"nothing was counted, so nothing was weighed ({seen}); true 0.150 kg" in said
    assert f"belt seen {'100.0 %' if looked else 'unknown'}" in said
    assert "0 counted, 1 true (-100.00 %)" in said
    assert "0.000" not in said
    assert "% of weight" not in said, "shares of nothing"
    score_command(tmp_path, truth=truth_file, json=True)
    told = json.loads(capsys.readouterr().out)
    assert set(told) == set(score(counted([]), truth([])).as_dict())
    assert (told["count"], told["coverage"], told["count_error_percent"]) == (0, 1.0 if looked else None, -100.0)
    weights = ("weight_g", "low_g", "high_g", "estimated_weight_g", "estimated_low_g", "estimated_high_g")
    assert [told[name] for name in weights] == [0.0 if looked else None] * 6
    assert told["weight_error_percent"] == told["estimated_error_percent"] == (-100.0 if looked else None)
    print_score(Console(file=(out := StringIO()), width=120), told)
    assert "nothing weighed" in out.getvalue()
