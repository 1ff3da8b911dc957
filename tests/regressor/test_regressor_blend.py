"""Volume rule, blend and the table of worlds: what they are fitted for, on made-up views whose truth is known."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from conveyor.errors import InputError
from conveyor.load_spread import shared_sd_share
from conveyor.statistics import NORMAL_90
from regressor.network.checkpoint import load_checkpoint, state_of
from regressor.network.sidecar import Sidecar
from regressor.studies.evaluate import SHIPPED, Evaluation
from regressor.studies.worlds import by_class, by_preset, markdown
from regressor.weigh import graph
from regressor.weigh.blend import BlendRule, fit_blend
from regressor.weigh.prepare import prepare_view
from regressor.weigh.quadratic import fit_quadratic
from regressor.weigh.surface import NAMES
from regressor.weigh.view_features import TYPICAL_PX, VIEW_NAMES, view_features
from regressor.weigh.volume import FIRST_NAMES, VolumeRule, fit_volume_rule
from regressor.weigh.weigher import Weigher, features_of
from tests.regressor.ellipsoids import ellipsoid_view

SEED = 7


def _views(count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(features (n, 37), weight_g, share of the rim lost): a lost rim takes area and volume and lifts the rim."""
    weight = rng.lognormal(5.0, 0.6, count)
    size = np.cbrt(weight / 150)
    squat = np.exp(rng.normal(0, 0.12, count))
    lost = rng.uniform(0.0, 0.15, count)
    area = 33 * size**2 * squat * (1 - lost)
    height = 52 * size / squat * np.exp(rng.normal(0, 0.02, count))
    values = {name: np.full(count, 0.1) for name in NAMES}
    values |= {
        "volume_ml": 0.083 * area * height,
        "area_cm2": area,
        "length_mm": 75 * size * (1 - lost / 2),
        "width_mm": 60 * size * (1 - lost / 2),
        "height_mm": height,
        "hull_cm2": 1.02 * area,
        "area50_cm2": area,
        "area70_cm2": 27 * size**2 * squat,
        "area85_cm2": 17 * size**2 * squat,
        "curvature_cm2": 30 * size**2 * squat,
        "rim": 0.5 + 1.2 * lost,
        "rim_low": 0.4 + 1.2 * lost,
    }
    surface = np.column_stack([values[name] for name in NAMES])
    return view_features(surface, np.full(len(surface), 0.03), np.full(len(surface), 0.002)), weight, lost


def test_the_volume_rule_sees_through_a_lost_rim() -> None:
    rng = np.random.default_rng(SEED)
    features, weight, _ = _views(3000, rng)
    new, truth, lost = _views(2000, rng)
    rule = fit_volume_rule(features, weight)
    five = fit_volume_rule(features, weight, names=FIRST_NAMES, squares=False)
    for name, rows in (("exact", lost < 0.03), ("poor", lost > 0.12)):
        bias = rule.weights_g(new[rows]).sum() / truth[rows].sum() - 1
        assert abs(bias) < 0.01, f"seed {SEED}, {name}: {bias:+.3f}"
    assert np.abs(rule.weights_g(new) / truth - 1).mean() < np.abs(five.weights_g(new) / truth - 1).mean()
    assert VolumeRule.from_json(json.loads(json.dumps(rule.to_json()))) == rule
    with pytest.raises(ValueError, match="colour"):
        VolumeRule.from_json({**five.to_json(), "names": ["colour"]})


def test_a_rule_is_held_where_a_view_lies_far_outside_of_its_fit() -> None:
    """A fit that saw one pixel in 3000 missing read views with 5 % missing as 960 times their weight: the share of
    holes ran on in a straight line. The exported graph must hold it alike.
    """
    rng = np.random.default_rng(SEED)
    features, weight, _ = _views(3000, rng)
    holes = NAMES.index("hole_share")
    features[:, holes] = 3e-4 * rng.random(3000)
    weight *= np.exp(600 * features[:, holes])
    rule = fit_volume_rule(features, weight, names=(*FIRST_NAMES, "hole_share"))
    near, far = features[:200].copy(), features[:200].copy()
    far[:, holes] = 0.05
    assert np.median(rule.weights_g(far) / rule.weights_g(near)) < 1.4
    assert rule.coefficients[-1] * 0.05 > np.log(50)  # what it would be read as
    far[::2, NAMES.index("length_mm")] *= 1e4
    for rows in (near, far):
        assert graph.volume_rule(rule, torch.from_numpy(rows)).numpy() == pytest.approx(rule.weights_g(rows), rel=1e-9)


def test_a_rule_from_before_the_other_features_weighs_as_it_did() -> None:
    rule = load_checkpoint()[1].fitted_volume_rule
    assert rule is not None
    old = {"intercept": 0.5, "coefficients": [1.0, 0.0, 0.0, 0.0, -0.1], "residual_ln_sd": 0.1, "names": FIRST_NAMES}
    cloud = prepare_view(ellipsoid_view())
    expected = np.exp(0.5) * cloud.surface.volume_ml * cloud.surface.height_mm**-0.1
    assert VolumeRule.from_json(old).weights_g(features_of(cloud, 0.002)) == pytest.approx(expected)


def test_a_rule_trusts_heights_as_far_as_the_level_is_known() -> None:
    """And a fit over views that are all alike in something says nothing of it."""
    rng = np.random.default_rng(SEED)
    count, area = 6000, rng.lognormal(3.5, 0.4, 6000)
    height = 9 * np.sqrt(area) * np.exp(0.1 * rng.standard_normal(count))
    weight, known = 0.09 * area * height, rng.random(count) < 0.5
    seen = height * np.where(known, 1.0, np.exp(0.1 * rng.standard_normal(count)))
    surface = np.full((count, len(NAMES)), 0.1)
    for name, values in (("volume_ml", 0.083 * area * seen), ("area_cm2", area), ("height_mm", seen)):
        surface[:, NAMES.index(name)] = values
    noise_px, sd_m = np.full(count, 0.03), np.where(known, 0.0005, 0.0025)
    errors = []
    for rows in (view_features(surface, noise_px, sd_m), view_features(surface, noise_px, np.full(count, 0.002))):
        rule = fit_volume_rule(rows[:4000], weight[:4000])
        errors.append(np.abs(rule.weights_g(rows[4000:]) / weight[4000:] - 1).mean())
    assert errors[0] < 0.8 * errors[1], f"seed {SEED}: {errors}"
    other = view_features(surface, np.full(count, 0.1), sd_m)
    assert rule.weights_g(other) == pytest.approx(rule.weights_g(rows), rel=1e-9)
    assert (view_features(surface, np.full(count, np.nan), sd_m)[:, -2] == TYPICAL_PX).all()


def test_the_blend_leaves_no_bias_over_true_size_and_rim() -> None:
    """A part of the correction for the rim is applied (STRENGTH); all of that for the weight."""
    rng = np.random.default_rng(SEED)
    features, weight, lost = _views(8000, rng)
    # Both parts shrink towards the middle, as what is fitted to noisy views does, and both lose with the rim.
    shrunk = np.exp(5.0 + 0.96 * (np.log(weight) - 5.0))
    network, volume = (shrunk * (1 - 0.4 * lost) * np.exp(rng.normal(0, sd, 8000)) for sd in (0.06, 0.08))
    truth = lost[:, None]
    seen = (fit_quadratic(features, lost, names=VIEW_NAMES),)
    found = np.column_stack([rule.values(features) for rule in seen])
    assert np.corrcoef(found[:, 0], lost)[0, 1] > 0.9
    half = np.arange(8000) < 4000
    parts = network[half], volume[half], weight[half]
    rule = fit_blend(*parts, found=found[half], truth=truth[half], seen=seen)
    plain = fit_blend(*parts)
    bias: dict[str, tuple[float, float]] = {}
    for name, rows in (
        ("all", weight > 0),
        ("small", weight < 90),
        ("large", weight > 300),
        ("poor rim", lost > 0.12),
        ("exact rim", lost < 0.03),
    ):
        chosen = rows & ~half
        both = [r.weights_g(network[chosen], volume[chosen], features[chosen]).sum() for r in (plain, rule)]
        bias[name] = (both[0] / weight[chosen].sum() - 1, both[1] / weight[chosen].sum() - 1)
    for name in ("all", "small", "large"):
        assert abs(bias[name][1]) < 0.012, f"seed {SEED}, {name}: {bias[name]}"
    for name in ("poor rim", "exact rim"):
        assert abs(bias[name][1]) < 0.8 * abs(bias[name][0]), f"seed {SEED}, {name}: {bias[name]}"
    assert BlendRule.from_json(json.loads(json.dumps(rule.to_json()))) == rule
    strange = features[:1].copy()
    strange[0, NAMES.index("rim")] = 40.0
    again = rule.weights_g(network[:1], volume[:1], strange)
    assert 0.8 < again[0] / np.sqrt(network[0] * volume[0]) < 1.25
    with pytest.raises(ValueError, match="colour"):
        BlendRule.from_json(rule.to_json() | {"seen": {"colour": seen[0].to_json()}})


@pytest.mark.parametrize("alike", ["rim", "found", "weight"])
def test_what_is_alike_in_all_views_of_a_world_says_nothing(alike: str) -> None:
    """A pack whose rims are all whole ended the fit in 'Singular matrix'; the others are corrected for as ever."""
    rng = np.random.default_rng(SEED)
    features, weight, lost = _views(400, rng)
    world = np.where(np.arange(400) % 2, "easy", "harsh")
    of_world = np.where(world == "easy", 0.1, 0.2)
    truth, found = (of_world if alike == which else lost for which in ("rim", "found"))
    weight = 1500 * of_world if alike == "weight" else weight
    network = weight * np.exp(rng.normal(0, 0.05, 400))
    seen = (fit_quadratic(features, lost, names=VIEW_NAMES),)
    rule = fit_blend(network, network, weight, world=world, found=found[:, None], truth=truth[:, None], seen=seen)
    if alike == "weight":
        assert (rule.slope, rule.seen) == (0.0, seen)
    else:
        assert rule == fit_blend(network, network, weight, world=world)
        assert rule.slope != 0


def test_a_network_that_knows_nothing_gets_no_blend() -> None:
    """Its sidecar was written all the same, held no number, and could not be read any more."""
    weight = np.random.default_rng(SEED).lognormal(5.0, 0.5, 400)
    with pytest.raises(InputError, match=r"answers are 0\.0001 times the truth in the median\. Train it further"):
        fit_blend(1e-4 * weight, weight * 1e-4, weight)


def test_worlds_that_nothing_in_a_view_tells_apart_share_the_blame() -> None:
    rng = np.random.default_rng(SEED)
    weight = rng.lognormal(5.0, 0.5, 4000)
    world = np.where(rng.random(4000) < 0.8, "easy", "harsh")
    network = weight * np.where(world == "harsh", 1.04, 1.0)
    rule = fit_blend(network, network, weight, world=world)
    found = rule.weights_g(network, network, np.zeros((4000, len(NAMES))))
    for name, sign in (("easy", -1), ("harsh", 1)):
        rows = world == name
        assert found[rows].sum() / weight[rows].sum() - 1 == pytest.approx(0.02 * sign, abs=0.002)


def test_a_weigher_blends_by_its_sidecar() -> None:
    model, sidecar = load_checkpoint()
    cloud = prepare_view(ellipsoid_view())
    plain = sidecar.model_copy(update={"blend": None, "volume_share": 0.3})
    by_share = Weigher(state_of(model), plain).weigh(cloud)
    assert by_share.network_g is not None
    expected = by_share.network_g**0.7 * by_share.volume_g**0.3
    assert by_share.weight_g == pytest.approx(expected, abs=0.01)
    rule = BlendRule(0.5, intercept=float(np.log(1.1))).to_json()
    corrected = Weigher(state_of(model), Sidecar.model_validate(plain.model_dump() | {"blend": rule})).weigh(cloud)
    assert corrected.weight_g == pytest.approx(1.1 * np.sqrt(by_share.network_g * by_share.volume_g), abs=0.01)


def _evaluation(rng: np.random.Generator) -> Evaluation:
    """60 recordings of 20 tubers with 2 views in two presets; 'poor' rims read 4 % light in one of them."""
    recording = np.repeat(np.arange(60), 40)
    tuber = np.repeat(np.arange(1200), 2)
    truth = np.repeat(rng.lognormal(5.0, 0.5, 1200), 2)
    preset = np.where(recording % 2 == 0, "field", "harsh")
    rim = np.where(rng.random(2400) < 0.5, "exact", "poor")
    shared = np.repeat(rng.normal(0, 0.03, 60), 40)
    light = np.where((preset == "harsh") & (rim == "poor"), -0.04, 0.0)
    found = truth * (1 + shared + light + np.repeat(rng.normal(0, 0.05, 1200), 2))
    half = 1.645 * np.hypot(0.03, 0.05) * found
    return Evaluation(
        predicted={SHIPPED: found},
        low_g=found - half,
        high_g=found + half,
        weight_g=truth,
        tuber=tuber.astype(str),
        recording=recording.astype(str),
        level_sd_m=np.full(2400, 0.001),
        unlike=np.zeros(2400, np.bool_),
        groups={"preset": preset, "rim": rim},
        flags={},
        refused={},
        shared_sd_share=1.0,
        shared_bias_share=1.645 * 0.03,
        shared_level_share_per_mm=0.0,
        shared_other_share=0.0,
        model="made-up@00000000",
    )


def test_the_table_of_worlds_finds_the_class_that_is_biased() -> None:
    result = _evaluation(np.random.default_rng(SEED))
    classes = {(row.label, row.preset): row for row in by_class(result, ("rim", "weight"))}
    poor = classes["poor", "harsh"]
    assert poor.low_percent is not None
    assert poor.high_percent is not None
    assert poor.high_percent < -1.5
    assert poor.low_percent < poor.bias_percent < poor.high_percent
    assert poor.recordings == 30
    low, high = classes["poor", "field"].low_percent, classes["poor", "field"].high_percent
    assert low is not None
    assert high is not None
    assert low < 0.0 < high
    presets = {row.preset: row for row in by_preset(result)}
    assert presets["field"].views_held == pytest.approx(0.9, abs=0.04)
    assert presets["field"].loads_held >= 0.8
    shared = 100 * NORMAL_90 * shared_sd_share(1.0)
    own = 100 * NORMAL_90 * np.hypot(0.03, 0.05) / np.sqrt(20)
    assert presets["field"].load_half_percent == pytest.approx(np.hypot(shared, own), abs=0.4), "the ledger's rule"
    assert presets["all"].views == 2400
    text = markdown(list(presets.values()), list(classes.values()))
    assert "| rim | poor |" in text
    assert "over 300 g" in text


def test_one_recording_tells_nothing_of_another() -> None:
    """The 90 % interval over drawn recordings of a single one, as of any 3DPotatoTwin folder, had no width."""
    result = _evaluation(np.random.default_rng(SEED))
    one = replace(result, recording=np.full(2400, "unknown"), groups={"rim": result.groups["rim"]})
    (whole,) = by_preset(one)
    assert (whole.recordings, whole.low_percent, whole.high_percent) == (1, None, None)
    text = markdown([whole], by_class(one, ("rim",)))
    assert f"| {whole.bias_percent:+.1f} (one recording) |" in text


def test_between_what_the_fit_has_seen_the_shipped_rule_goes_straight() -> None:
    """Its worlds know their belts to half a millimetre or hardly at all; a square between the two could be anything."""
    rule = load_checkpoint()[1].fitted_volume_rule
    assert rule is not None
    cloud = prepare_view(ellipsoid_view())
    known, hardly = (float(rule.weights_g(features_of(cloud, sd_m))[0]) for sd_m in (0.0005, 0.003))
    for sd_m in (0.0006, 0.0007, 0.001, 0.0015, 0.002):
        between = float(rule.weights_g(features_of(cloud, sd_m))[0])
        assert min(known, hardly) - 0.5 < between < max(known, hardly) + 0.5, f"{sd_m}: {known}, {between}, {hardly}"
