"""Weighing: the same view gives the same bits, out of range is flagged, refusals and intervals are what they say."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import replace
from subprocess import run

import numpy as np
import pytest
import torch

from conveyor.camera_range import camera_range
from conveyor.config import CameraConfig, LineConfig, RegressorConfig
from conveyor.errors import InputError
from conveyor.geometry import straight_down_belt_from_camera
from regressor.network.edges import edge_differences_bfloat16, pooled_maximum_bfloat16
from regressor.network.fast import Form
from regressor.network.grouping import GatheredGroups, group_prefix
from regressor.network.sidecar import Range, Sidecar, checked_name
from regressor.network.stored import load_weights
from regressor.serve.form import fastest, form_of
from regressor.studies.evaluate import load_bias
from regressor.training.calibration import fused_share
from regressor.weigh.interval import FARTHER, IntervalRule, calibrate
from regressor.weigh.prepare import PARTS, prepare_view
from regressor.weigh.viewscale import view_terms
from regressor.weigh.weigher import PARTED, Weigher, weigh_view, weigh_views
from tests.regressor.ellipsoids import DENSITY, ellipsoid_view

AXES = (0.042, 0.033, 0.028)
TRUE_G = DENSITY * 4e6 / 3 * np.pi * float(np.prod(AXES))

WITHOUT_BFLOAT16 = f"""
from regressor.network.fast import Form, multiplies_bfloat16
from regressor.serve.form import fastest
from regressor.weigh.prepare import prepare_view
from regressor.weigh.weigher import Weigher
from tests.regressor.ellipsoids import ellipsoid_view

weigher = Weigher.load()
cloud = prepare_view(ellipsoid_view({AXES}))
asked_for = weigher.in_form(Form("bfloat16", 64)).weigh(cloud)
near = abs(asked_for.weight_g - weigher.weigh(cloud).weight_g) < 1.0
print(multiplies_bfloat16(), fastest(weigher).precision, asked_for.flags[0], near)
"""


@pytest.fixture(scope="module")
def weigher() -> Weigher:
    return Weigher.load()


def test_the_shipped_weights_weigh_an_ellipsoid(weigher: Weigher) -> None:
    """The network has never seen an ideal ellipsoid; a fifth off would mean that something is broken."""
    answer = weigh_view(weigher, ellipsoid_view(AXES), regressor="r1")
    assert answer.status == "weighed"
    assert answer.method == "pointraft"
    assert answer.weight_g == pytest.approx(TRUE_G, rel=0.2)
    assert answer.low_g is not None
    assert answer.high_g is not None
    assert answer.low_g < answer.weight_g < answer.high_g  # type: ignore[operator]
    assert answer.flags == ()
    assert answer.model.startswith("tuberline-sim@")


def test_a_camera_noisier_than_the_trained_ones_is_flagged_and_changes_no_weight(weigher: Weigher) -> None:
    most_px = camera_range(weigher.sidecar.worlds).local_px[1]
    view = ellipsoid_view(AXES)
    answers = [
        weigh_view(weigher, replace(view, camera_noise_px=px), regressor="r1") for px in (None, most_px, 2 * most_px)
    ]
    assert ["camera_noise" in answer.flags for answer in answers] == [False, False, True]
    assert len({answer.weight_g for answer in answers}) == 1


def test_what_a_camera_takes_off_outlines_beyond_the_trained_ones_makes_a_weight_heavier(weigher: Weigher) -> None:
    view = ellipsoid_view(AXES)
    none, two, ten = (weigh_view(weigher, replace(view, outline_lost_mm=mm), regressor="r1") for mm in (0.0, 2.0, 10.0))
    for answer, share in ((two, 1.0408), (ten, 1.0833)):
        for name in ("weight_g", "low_g", "high_g"):
            assert getattr(answer, name) == pytest.approx(share * getattr(none, name), rel=1e-4)


def test_a_weight_does_not_depend_on_what_was_weighed_before(weigher: Weigher) -> None:
    views = [ellipsoid_view((0.03 + 0.004 * i, 0.03, 0.026), name=f"t{i}/0") for i in range(4)]
    views.append(ellipsoid_view((0.12, 0.03, 0.03), name="wide/0"))
    forward = {view.view_id: weigh_view(weigher, view, regressor="r1") for view in views}
    fresh = Weigher.load()
    backward = {view.view_id: weigh_view(fresh, view, regressor="r1") for view in reversed(views)}
    assert forward == backward


def test_units_and_belt_distance_do_not_matter(weigher: Weigher) -> None:
    reference = weigher.weigh(prepare_view(ellipsoid_view(AXES))).weight_g
    for view in (
        ellipsoid_view(AXES, depth_scale_m=0.0001),
        ellipsoid_view(AXES, belt_distance_m=0.465),
        ellipsoid_view(AXES, tilt_deg=4.0),
    ):
        assert weigher.weigh(prepare_view(view)).weight_g == pytest.approx(reference, rel=0.06)


def test_faster_forms_cost_little_and_say_so(weigher: Weigher) -> None:
    cloud = prepare_view(ellipsoid_view(AXES))
    exact = weigher.weigh(cloud)
    for form, flags in ((Form("bfloat16"), ("bfloat16",)), (Form("bfloat16", 16), ("bfloat16", "centroids_16"))):
        answer = weigher.in_form(form).weigh(cloud)
        assert answer.flags == flags
        assert answer.weight_g == pytest.approx(exact.weight_g, abs=1.0)
        assert answer.weight_g != exact.weight_g
    assert weigher.in_form(weigher.form) is weigher


def test_the_fewest_centroids_are_taken_that_cost_little(weigher: Weigher, monkeypatch: pytest.MonkeyPatch) -> None:
    assert fastest(weigher).centroids == 16
    assert fastest(weigher, centroids=64).centroids == 64
    cloud = prepare_view(ellipsoid_view(AXES))
    answer = weigher.in_form(Form(centroids=16)).weigh(cloud)
    assert answer.flags == ("centroids_16",)
    assert answer.weight_g == pytest.approx(weigher.weigh(cloud).weight_g, abs=0.2)
    monkeypatch.setattr("regressor.serve.form.MOST_OFF_G", 0.0)
    assert fastest(weigher) == Form()


def test_a_replay_weighs_alike_on_every_machine(weigher: Weigher, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where bfloat16 pays a live line takes it; a replay, whose ledger is compared, does not."""
    monkeypatch.setattr("regressor.serve.form.multiplies_bfloat16", lambda: True)
    monkeypatch.setattr("regressor.serve.form.WORTH", float("inf"))
    monkeypatch.setattr("regressor.serve.form.MOST_OFF_G", 10.0)
    replayed = LineConfig(cameras={"front": CameraConfig()})
    live = LineConfig(cameras={"front": CameraConfig(waits=False)})
    assert form_of(replayed, weigher) == Form()
    assert form_of(live, weigher) == Form("bfloat16", 16)
    exact = live.model_copy(update={"regressor": RegressorConfig(precision="float32")})
    assert form_of(exact, weigher) == Form()


def test_a_cloud_whose_centroids_see_different_points_keeps_all_of_them(weigher: Weigher) -> None:
    """Of two tubers in one mask half of the centroids may lie on either; a sixteenth of them tells of one."""
    cloud = prepare_view(ellipsoid_view((0.14, 0.033, 0.028)))
    assert isinstance(group_prefix(cloud.points), GatheredGroups)
    assert weigher.in_form(Form(centroids=16)).network_g(cloud) == weigher.network_g(cloud)


@pytest.mark.parametrize("signs", [(1, 1), (-1, -1), (1, -1)])
def test_edges_in_bfloat16_round_as_torch_does(rng: np.random.Generator, signs: tuple[int, int]) -> None:
    """Also where the maximum is below zero: the order of bit patterns turns round there."""
    source = (rng.random((64, 37)) * signs[0]).astype(np.float32)
    centroid = (rng.random((5, 37)) * 0.5).astype(np.float32)
    out = np.empty((5 * 64, 37), np.uint16)
    edge_differences_bfloat16(source, centroid, out)
    expected = torch.relu(torch.from_numpy(source[None] - centroid[:, None])).bfloat16().reshape(-1, 37)
    assert torch.equal(torch.from_numpy(out).view(torch.bfloat16), expected)
    values = torch.from_numpy(rng.normal(size=(5 * 64, 37)) + 3 * signs[1]).bfloat16()
    pooled = np.empty((5, 37), np.float32)
    pooled_maximum_bfloat16(values.view(torch.int16).numpy(), pooled)
    assert np.array_equal(pooled, values.reshape(5, 64, 37).amax(1).float().numpy())


def test_out_of_range_is_flagged(weigher: Weigher) -> None:
    narrow = weigher.sidecar.model_copy(
        update={
            "belt_distance_m": Range(low=0.4, high=0.5),
            "length_mm": Range(low=10, high=20),
            "weight_g": Range(low=1, high=2),
        }
    )
    for state in (load_weights()[0], None):
        answer = Weigher(state, narrow).weigh(prepare_view(ellipsoid_view(AXES)))
        assert answer.method == ("volume" if state is None else "pointraft")
        assert answer.flags == ("belt_distance", "size", "weight"), "by volume nothing was told"


def test_farther_away_than_calibrated_an_interval_grows_with_the_distance(weigher: Weigher) -> None:
    state, sidecar = load_weights()
    cloud = prepare_view(ellipsoid_view(AXES))
    near = weigher.weigh(cloud)
    far_m = cloud.belt_distance_m / 1.4
    interval = {name: value for name, value in (sidecar.interval or {}).items() if name != "farthest_m"}
    for told in (
        {"belt_distance_m": Range(low=0.1, high=far_m), "interval": interval},
        {"interval": {**interval, "farthest_m": far_m}},
    ):
        far = Weigher(state, sidecar.model_copy(update=told)).weigh(cloud)
        assert far.weight_g == near.weight_g
        assert far.flags == ("belt_distance",)
        assert near.flags == ()
        wider = 1.4**FARTHER
        assert far.weight_g - far.low_g == pytest.approx(wider * (near.weight_g - near.low_g), abs=0.01)
        assert far.high_g - far.weight_g == pytest.approx(wider * (near.high_g - near.weight_g), abs=0.01)


def test_in_parts_an_interval_is_wider_whichever_method_answers(weigher: Weigher) -> None:
    """Of views with a wide gap, which read heavy, 76 % of the intervals held."""
    cloud = prepare_view(ellipsoid_view(AXES))
    parted = replace(cloud, flags=(PARTS,))
    for method in (weigher, Weigher(None, weigher.sidecar)):
        whole, wider = method.weigh(cloud), method.weigh(parted)
        assert (wider.weight_g, wider.flags) == (whole.weight_g, (PARTS, *whole.flags))
        assert wider.weight_g - wider.low_g == pytest.approx(PARTED * (whole.weight_g - whole.low_g), abs=0.01)
        assert wider.high_g - wider.weight_g == pytest.approx(PARTED * (whole.high_g - whole.weight_g), abs=0.01)


def test_without_a_network_the_visible_volume_weighs() -> None:
    answer = Weigher(None, Weigher.load().sidecar).weigh(prepare_view(ellipsoid_view(AXES)))
    assert answer.method == "volume"
    assert answer.model == "volume"
    assert answer.weight_g == pytest.approx(TRUE_G, rel=0.2)
    assert answer.low_g < answer.weight_g < answer.high_g


def test_a_weight_that_no_tuber_has_is_refused_not_sent() -> None:
    view = ellipsoid_view()
    wide = replace(view, intrinsics=replace(view.intrinsics, fx=0.02, fy=0.02))
    by_volume = Weigher(None, Weigher.load().sidecar)
    assert by_volume.weigh(prepare_view(wide)).weight_g > 1e5
    answer = weigh_view(by_volume, wide, regressor="r1")
    assert (answer.status, answer.reason) == ("refused", "out_of_range")
    assert type(answer).decode(answer.encode()) == answer


def test_a_refusal_names_its_reason(weigher: Weigher) -> None:
    empty = replace(ellipsoid_view(), depth=np.zeros((20, 20), np.uint16))
    answer = weigh_view(weigher, empty, regressor="r1")
    assert (answer.status, answer.reason, answer.weight_g) == ("refused", "empty_cloud", None)
    assert answer.encode()


@pytest.mark.parametrize("device", [None, "cpu"])
@pytest.mark.parametrize(
    ("belt_m", "reason"),
    [(-0.4, "below_belt"), (0.02, "below_belt"), (0.28, "below_belt"), (0.291, "off_the_belt"), (30.0, "off_the_belt")],
)
def test_a_view_off_its_belt_is_refused_and_the_others_of_its_batch_are_weighed(
    weigher: Weigher, device: str | None, belt_m: float, reason: str
) -> None:
    """A division by zero ended the process, and with it the views beside it; under a belt 30 m away it weighed 3 kg."""
    view = ellipsoid_view(AXES)
    off = replace(view, belt_from_camera=straight_down_belt_from_camera(belt_m))
    answers = weigh_views(weigher.on(device), [view, off, view], regressor="r1")
    assert [(answer.status, answer.reason) for answer in answers] == [
        ("weighed", ""), ("refused", reason), ("weighed", "")
    ]  # fmt: skip
    assert answers[0] == answers[2]
    assert [answer.reason for answer in weigh_views(weigher.on(device), [off], regressor="r1")] == [reason]


def _drawn(rng: np.random.Generator, tubers: int, *, shared: float = 0.8) -> dict[str, np.ndarray]:
    """Views whose errors grow with the weight, with how steep the tuber stands and with how badly the belt is known."""
    truth = np.repeat(rng.gamma(2.4, 70, tubers) + 10, 4)
    steep = np.repeat(np.where(rng.random(tubers) < 0.5, 0.0, rng.uniform(0, 0.6, tubers)), 4)
    normal = shared * np.repeat(rng.normal(size=tubers), 4) + np.sqrt(1 - shared**2) * rng.normal(size=4 * tubers)
    belt_sd_m = np.repeat(rng.choice([0.0, 0.002, 0.004], tubers), 4)
    worse = np.hypot(1.0, belt_sd_m / 0.002)
    predicted = np.maximum(truth + normal * (3 + 0.03 * truth) * np.exp(2 * steep) * worse, 2.0)
    width = np.full(len(truth), 50.0)
    features = np.column_stack([4 * truth, truth, width, width, width])
    terms = view_terms(predicted, predicted, predicted, features, 0.05 * np.exp(steep), belt_sd_m)
    tuber = np.repeat(np.arange(tubers), 4).astype(str)
    return {
        "predicted": predicted, "truth": truth, "terms": terms, "steep": steep, "belt_sd_m": belt_sd_m, "tuber": tuber
    }  # fmt: skip


def test_conformal_intervals_cover_what_they_promise(rng: np.random.Generator) -> None:
    """Also among views of one kind: one width for all would cover nearly all resting and too few steep tubers."""
    seen = _drawn(rng, 1500)
    rule = calibrate(seen["predicted"], seen["truth"], seen["terms"])
    new = _drawn(rng, 5000)
    low, high = rule.bounds_g(new["predicted"], new["terms"])
    held = (new["truth"] >= low) & (new["truth"] <= high)
    assert held.mean() == pytest.approx(0.9, abs=0.02)
    kinds = [new["predicted"] < 100, new["predicted"] > 300, new["steep"] == 0, new["steep"] > 0.4]
    for kind in (*kinds, *(new["belt_sd_m"] == sd_m for sd_m in (0.0, 0.002, 0.004))):
        assert held[kind].mean() == pytest.approx(0.9, abs=0.05)
    assert IntervalRule.from_json(rule.to_json()) == rule
    assert IntervalRule.from_json(json.loads(json.dumps(rule.to_json()))) == rule


def test_a_belt_that_is_known_worse_widens_the_interval_and_makes_heights_count_less(weigher: Weigher) -> None:
    """Between what belts that are known well and badly were in the fit; beyond, the weight stays."""
    cloud = prepare_view(ellipsoid_view(AXES))
    answers = [weigher.weigh(cloud, belt_sd_m=sd_m) for sd_m in (0.0, 0.0005, 0.002, 0.005, 0.02)]
    widths = [answer.high_g - answer.low_g for answer in answers]
    assert widths == sorted(widths)
    assert widths[-1] > 2 * widths[0]
    weights = [answer.weight_g for answer in answers]
    assert weights[0] == weights[1]
    assert weights[3] == weights[4]
    assert 0 < abs(weights[3] / weights[0] - 1) < 0.05
    part = np.log(2 / 0.58) / np.log(2.5 / 0.58)
    assert weights[2] == pytest.approx(weights[0] + part * (weights[3] - weights[0]), rel=1e-3)
    view = replace(ellipsoid_view(AXES), belt_sd_m=0.005)
    assert weigh_view(weigher, view, regressor="r1").high_g == answers[3].high_g


def test_an_interval_from_before_there_was_a_scale_stays_in_grams() -> None:
    old = {"level": 0.9, "at_g": [50, 200], "below_g": [-5, -20], "above_g": [6, 24], "views": 100}
    low, high = IntervalRule.from_json(old).bounds_g(np.array([50.0, 125.0]), np.zeros((2, 6)))
    assert low == pytest.approx([45.0, 112.5])
    assert high == pytest.approx([56.0, 140.0])


@pytest.mark.parametrize("shared", [0.0, 0.6, 0.95])
def test_intervals_of_fused_tubers_know_what_views_share(rng: np.random.Generator, shared: float) -> None:
    seen = _drawn(rng, 1500, shared=shared)
    rule = calibrate(seen["predicted"], seen["truth"], seen["terms"])
    low, high = rule.bounds_g(seen["predicted"], seen["terms"])
    share = fused_share(seen["predicted"], low, high, seen["truth"], seen["tuber"], level=0.9)
    assert share == pytest.approx(shared, abs=0.12 if shared else 0.35)
    middle, half, truth = (v.reshape(-1, 4).mean(1) for v in (seen["predicted"], (high - low) / 2, seen["truth"]))
    held = np.abs(truth - middle) <= half * np.sqrt(share**2 + (1 - share**2) / 4)
    assert held.mean() == pytest.approx(0.9, abs=0.03)


def test_load_bias_is_the_bias_of_the_total() -> None:
    truth = np.linspace(50, 400, 500)
    figures = load_bias(1.02 * truth, truth, np.arange(500).astype(str))
    assert figures["load_bias_percent"] == pytest.approx(2.0, abs=1e-3)


def test_a_sidecar_with_an_unknown_key_is_refused() -> None:
    with pytest.raises(ValueError, match="colour"):
        Sidecar.model_validate({"name": "a", "colour": "red"})


def test_weights_are_called_what_messages_can_carry() -> None:
    """A checkpoint картофель.pth had no name that was allowed, and one with a line break ended every regressor."""
    for name in ("картофель", "my weights", "-"):
        assert checked_name(Sidecar(name=name).name) == name
    for name in ("", "a\nb", "a\n", "x" * 257):
        with pytest.raises(InputError, match="allowed are 1 to 256 characters"):
            checked_name(name)
        with pytest.raises(ValueError, match="name"):
            Sidecar(name=name)


def test_a_processor_without_bfloat16_weighs_in_another_form() -> None:
    """Every live regressor, and `replay --fast`, ended at its start on a processor with AVX2 alone.

    oneDNN is told to use no more than AVX2; on a processor that has no more it changes nothing.
    """
    said = run(
        [sys.executable, "-c", WITHOUT_BFLOAT16],
        env=os.environ | {"ONEDNN_MAX_CPU_ISA": "AVX2"},
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )
    assert said.stdout.split() == ["False", "float32", "bfloat16", "True"]
