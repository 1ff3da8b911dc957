"""Intervals from few tubers: what counts is tubers, and a belt that is known worse only ever widens them."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from regressor.network.sidecar import Sidecar
from regressor.network.stored import SHIPPED
from regressor.training.calibration import calibration, varied
from regressor.training.cloudset import load_cloudset
from regressor.training.tuber_interval import CONFIDENCE, calibrate_tubers, interval_told
from regressor.weigh.blend import BlendRule
from regressor.weigh.interval import IntervalRule, calibrate
from regressor.weigh.viewscale import BELT, TYPICAL_SLOPES, fit_scale, view_terms
from tests.regressor.ellipsoids import write_pack
from tests.regressor.twin_folder import write_twin
from tuberline.cli.calibrate_blend import calibrate_blend
from tuberline.cli.calibrate_interval import calibrate_interval

Drawn = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.str_]]


def _drawn(rng: np.random.Generator, tubers: int, views: int, *, shared: float = 0.85, sd: float = 0.06) -> Drawn:
    """(truth, predicted, terms, tuber) of views whose errors are a share of the weight; a tuber's share most of it.

    All belts are known to 2 mm, as in a folder that does not say.
    """
    truth = np.repeat(np.exp(rng.uniform(np.log(30), np.log(400), tubers)), views)
    normal = shared * np.repeat(rng.normal(size=tubers), views)
    normal = normal + np.sqrt(1 - shared**2) * rng.normal(size=tubers * views)
    predicted = truth * (1 + sd * normal)
    other = predicted * np.exp(0.03 * rng.normal(size=len(truth)))
    width = rng.uniform(40, 60, len(truth))
    features = np.column_stack([0.9 * truth, 0.25 * truth, 1.3 * width, width, width])
    height_m = 1e-3 * width * np.exp(rng.uniform(-0.3, 0.3, len(truth)))
    terms = view_terms(predicted, other, predicted**2 / other, features, height_m, np.full(len(truth), 0.002))
    return truth, predicted, terms, np.repeat(np.arange(tubers), views).astype(str)


def _held(rule: IntervalRule, new: Drawn) -> float:
    low, high = rule.bounds_g(new[1], new[2])
    return float(((new[0] >= low) & (new[0] <= high)).mean())


@pytest.mark.parametrize(("tubers", "views"), [(12, 6), (20, 8), (40, 30), (120, 30)])
def test_intervals_from_few_tubers_hold_what_they_promise(tubers: int, views: int) -> None:
    """Views were taken for independent: from 20 tubers with 8 views each intervals held 82 % in the mean, 53 % once."""
    rng = np.random.default_rng(tubers)
    new = _drawn(rng, 2000, 3)
    held = []
    for _ in range(40):
        truth, predicted, terms, tuber = _drawn(rng, tubers, views)
        held.append(_held(calibrate_tubers(predicted, truth, terms, tuber), new))
    assert np.mean(np.array(held) >= 0.9) >= CONFIDENCE - 0.1  # 40 draws: a standard deviation of 0.05
    assert 0.9 < np.mean(held) < 0.975
    assert min(held) > 0.75


def test_two_tubers_make_no_weight_class() -> None:
    """40 views did, be they of two tubers."""
    rng = np.random.default_rng(3)
    truth, predicted, terms, tuber = _drawn(rng, 30, 60)
    assert len(calibrate(predicted, truth, terms).at_g) > 1
    assert len(calibrate(predicted, truth, terms, tuber=tuber).at_g) == 1
    assert len(calibrate_tubers(predicted, truth, terms, tuber).at_g) == 1
    many = _drawn(rng, 1200, 1)
    assert len(calibrate_tubers(many[1], many[0], *many[2:]).at_g) > 1


def test_one_tuber_says_nearly_nothing_and_breaks_nothing() -> None:
    truth, predicted, terms, tuber = _drawn(np.random.default_rng(5), 1, 4)
    rule = calibrate_tubers(predicted, truth, terms, tuber)
    low, high = rule.bounds_g(predicted, terms)
    assert (low < truth).all()
    assert (truth < high).all()
    assert np.isfinite(high).all()


def test_tubers_are_what_is_independent_where_recordings_are_not_known(tmp_path: Path) -> None:
    write_pack(tmp_path / "pack", tubers=10, views=2, seed=1)
    data = load_cloudset(tmp_path / "pack")
    found = calibration(data.weight_g * 1.01, data.weight_g * 0.99, data, rule=BlendRule(0.5))
    assert found.counted == {"tubers": 10.0, "recordings": 0.0}
    # Weights hold no more: a training that has hardly begun to learn ended at its first validation.
    twice = data.subset(np.tile(np.arange(len(data)), 2))
    twice = replace(twice, tuber=np.arange(len(twice)).astype(str))
    wild = calibration(9 * twice.weight_g, 9 * twice.weight_g, twice, rule=BlendRule(0.5))
    assert Sidecar(name="w", **wild.sidecar_keys()).shared_bias_share == 1.0
    assert "10 are very few: weigh 40 tubers" in interval_told(10, 0)
    assert "very few" not in interval_told(40, 0)
    assert "taken for normal" in interval_told(40, 0)
    assert "taken for normal" not in interval_told(100, 0)
    assert interval_told(500, 25) == "90 % intervals are calibrated over 25 recordings"


@pytest.mark.parametrize("seed", range(6))
def test_a_belt_that_all_views_know_alike_says_nothing_of_others(seed: int) -> None:
    """The term followed area and volume alone: slopes from -3.4 to 6 came of it, and 10 mm of doubt made intervals
    vanish or a hundred times as wide.
    """
    truth, predicted, terms, tuber = _drawn(np.random.default_rng(seed), 40, 8)
    rule = calibrate_tubers(predicted, truth, terms, tuber, belt_slope=TYPICAL_SLOPES[BELT])
    assert rule.scale is not None
    assert rule.scale.slopes[BELT] == TYPICAL_SLOPES[BELT]
    widths = []
    for belt_sd_m in (0.0, 0.0005, 0.001, 0.002, 0.004, 0.01, 0.1):
        doubted = terms[:1].copy()
        doubted[:, BELT] = np.log(np.hypot(1.0, 100 * belt_sd_m * 0.25 / 0.9 / 0.05))
        low, high = rule.bounds_g(predicted[:1], doubted)
        widths.append(float(high[0] - low[0]))
    assert widths == sorted(widths)
    assert 1.4 < widths[3] / widths[0] < 1.6
    assert 3 < widths[5] / widths[3] < 4.5


def test_a_slope_over_the_belt_is_fitted_where_it_shows_and_never_falls() -> None:
    rng = np.random.default_rng(1)
    truth, predicted, terms, _ = _drawn(rng, 2000, 1)
    belt_sd_m = rng.choice([0.0005, 0.002, 0.004], len(truth))
    terms[:, BELT] = np.log(np.hypot(1.0, 100 * belt_sd_m * 0.25 / 0.9 / 0.05))
    for slope, found in ((0.7, 0.7), (-0.7, 0.0)):
        error_g = (truth - predicted) * np.exp(slope * terms[:, BELT])
        assert fit_scale(terms, error_g).slopes[BELT] == pytest.approx(found, abs=0.08)
    assert varied(belt_sd_m)
    assert not varied(np.full(100, 0.002))
    assert not varied(np.append(np.full(100, 0.002), 0.004))


def test_calibrations_tell_which_views_they_leave_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Only a training did: of a set with a wrong belt distance less was calibrated on than its owner believed."""
    weights = tmp_path / "w.safetensors"
    for ending in (".safetensors", ".json"):
        shutil.copy(SHIPPED.with_suffix(ending), weights.with_suffix(ending))
    write_twin(tmp_path / "crop", tubers=4)
    table = tmp_path / "crop" / "ground_truth.csv"
    first, row, *rest = table.read_text(encoding="utf-8").splitlines()
    table.write_text("\n".join([first, row.replace("0.42", "0.9"), *rest]), encoding="utf-8")
    calibrate_interval(weights, data=tmp_path / "crop")
    assert f"{tmp_path / 'crop'}: views left out: off_the_belt 1 (t000_depth_360.png)\n" in capsys.readouterr().err
    write_pack(tmp_path / "unseen", tubers=24, views=1, seed=5)
    shard = tmp_path / "unseen" / "views-00000.npz"
    with np.load(shard) as file:
        arrays = {name: file[name] for name in file.files}
    np.savez(shard, **arrays, recording=arrays["tuber"], soil_mm=np.where(arrays["tuber"] < 3, 1.0, 0.0))
    write_pack(tmp_path / "both" / "own", tubers=24, views=1, seed=6)
    shutil.copytree(tmp_path / "unseen", tmp_path / "both" / "unseen")
    calibrate_blend(weights, data=tmp_path / "both", unseen=tmp_path / "unseen")
    told = capsys.readouterr().err
    assert f"{tmp_path / 'both'}: views left out: in_unseen 24\n" in told
    assert f"{tmp_path / 'unseen'}: views left out: under_soil 3\n" in told
