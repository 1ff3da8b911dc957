"""Weighing: the same view gives the same bits, out of range is flagged, refusals and intervals are what they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from regressor.checkpoint import Range, Sidecar, load_checkpoint
from regressor.evaluate import load_bias
from regressor.interval import IntervalRule, calibrate, shared_share
from regressor.prepare import prepare_view
from regressor.weigher import Weigher, weigh_view
from tests.regressor.ellipsoids import DENSITY, ellipsoid_view

AXES = (0.042, 0.033, 0.028)
TRUE_G = DENSITY * 4e6 / 3 * np.pi * float(np.prod(AXES))


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


def test_out_of_range_is_flagged(weigher: Weigher) -> None:
    narrow = weigher.sidecar.model_copy(
        update={
            "belt_distance_m": Range(low=0.4, high=0.5),
            "length_mm": Range(low=10, high=20),
            "weight_g": Range(low=1, high=2),
        }
    )
    answer = Weigher(load_checkpoint()[0], narrow).weigh(prepare_view(ellipsoid_view(AXES)))
    assert set(answer.flags) == {"belt_distance", "size", "weight"}


def test_without_a_network_the_visible_volume_weighs() -> None:
    answer = Weigher(None, Weigher.load().sidecar).weigh(prepare_view(ellipsoid_view(AXES)))
    assert answer.method == "volume"
    assert answer.model == "volume"
    assert answer.weight_g == pytest.approx(TRUE_G, rel=0.2)
    assert answer.low_g < answer.weight_g < answer.high_g


def test_a_refusal_names_its_reason(weigher: Weigher) -> None:
    empty = replace(ellipsoid_view(), depth=np.zeros((20, 20), np.uint16))
    answer = weigh_view(weigher, empty, regressor="r1")
    assert (answer.status, answer.reason, answer.weight_g) == ("refused", "empty_cloud", None)
    assert answer.encode()


def test_conformal_intervals_cover_what_they_promise(rng: np.random.Generator) -> None:
    def draw(count: int) -> tuple[np.ndarray, np.ndarray]:
        truth = rng.gamma(2.4, 70, count)
        return truth + rng.normal(0, 4 + 0.06 * truth), truth

    rule = calibrate(*draw(4000))
    predicted, truth = draw(20000)
    low, high = rule.bounds_g(predicted)
    held = (truth >= low) & (truth <= high)
    assert held.mean() == pytest.approx(0.9, abs=0.02)
    assert held[predicted < 100].mean() == pytest.approx(0.9, abs=0.04)
    assert held[predicted > 300].mean() == pytest.approx(0.9, abs=0.05)
    assert IntervalRule.from_json(rule.to_json()) == rule


@pytest.mark.parametrize("share", [0.0, 0.6, 0.95])
def test_the_shared_part_of_the_error_is_found(rng: np.random.Generator, share: float) -> None:
    tuber = np.repeat(np.arange(600), 5).astype(str)
    residual = share * np.repeat(rng.normal(size=600), 5) + np.sqrt(1 - share**2) * rng.normal(size=3000)
    assert shared_share(residual, tuber) == pytest.approx(share, abs=0.06 if share else 0.15)


def test_load_bias_is_the_bias_of_the_total() -> None:
    truth = np.linspace(50, 400, 500)
    figures = load_bias(1.02 * truth, truth, np.arange(500).astype(str))
    assert figures["load_bias_percent"] == pytest.approx(2.0, abs=1e-3)


def test_a_sidecar_with_an_unknown_key_is_refused() -> None:
    with pytest.raises(ValueError, match="colour"):
        Sidecar.model_validate({"name": "a", "colour": "red"})
