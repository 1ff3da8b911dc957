"""Views of cameras unlike those trained for: told by noise and holes, and given intervals of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from conveyor.camera_flags import CAMERA_UNLIKE
from conveyor.depth_noise import crop_noise_px
from regressor.weigh.interval import IntervalRule, calibrate_cameras
from regressor.weigh.prepare import prepare_view
from regressor.weigh.surface import NAMES
from regressor.weigh.unlike import CameraRule
from regressor.weigh.viewscale import view_terms
from regressor.weigh.weigher import Weigher
from tests.regressor.ellipsoids import ellipsoid_view

SEED = 41
HOLES = NAMES.index("hole_share")


def _views(rng: np.random.Generator, recordings: int) -> dict[str, np.ndarray]:
    """25 views of each recording; half of them have a camera that is worse, and err twice as much as a whole."""
    unlike = np.repeat(rng.random(recordings) < 0.5, 25)
    n = len(unlike)
    noise_px = np.where(unlike, np.exp(rng.uniform(np.log(0.02), np.log(0.12), n)), rng.uniform(0.02, 0.045, n))
    truth = rng.gamma(2.4, 70, n) + 10
    shared = np.repeat(rng.normal(size=recordings), 25)
    error = (0.4 * shared + 0.92 * rng.normal(size=n)) * 0.06 * np.where(unlike, 2.0, 1.0)
    features = np.full((n, len(NAMES)), 50.0)
    features[:, HOLES] = np.where(unlike, rng.exponential(0.02, n), rng.exponential(0.0008, n))
    predicted = np.maximum(truth * (1 + error), 2.0)
    features[:, 0], features[:, 1] = 4 * predicted, predicted
    terms = view_terms(predicted, predicted, predicted, features, np.full(n, 0.05), np.full(n, 0.001))
    return {
        "predicted_g": predicted, "weight_g": truth, "terms": terms, "noise_px": noise_px, "features": features,
        "unlike": unlike, "recording": np.repeat(np.arange(recordings), 25).astype(str),
    }  # fmt: skip


def test_each_kind_of_camera_is_held_though_none_is_known_for_sure() -> None:
    rng = np.random.default_rng(SEED)
    rule = calibrate_cameras(**_views(rng, 400))
    new = _views(rng, 800)
    chance = rule.unlike(new["noise_px"], new["features"])
    low, high = rule.bounds_g(new["predicted_g"], new["terms"], chance)
    held = (new["weight_g"] >= low) & (new["weight_g"] <= high)
    assert held[new["unlike"]].mean() == pytest.approx(0.9, abs=0.03), f"seed {SEED}"
    # A few of those trained for look like the others and are as wide: they hold oftener than is asked for.
    assert 0.88 < held[~new["unlike"]].mean() < 0.95, f"seed {SEED}"
    width = (high - low) / new["predicted_g"]
    assert np.median(width[new["unlike"]]) > 1.6 * np.median(width[~new["unlike"]])
    assert IntervalRule.from_json(rule.to_json()) == rule


def test_cameras_that_no_view_tells_apart_share_an_interval() -> None:
    """The interval of those that are recognised was made of no view at all, which ended the calibration."""
    views = _views(np.random.default_rng(SEED), 100)
    views["noise_px"][:], views["features"][:, HOLES] = 0.03, 0.0
    views["unlike"][:] = np.arange(len(views["unlike"])) % 25 == 0
    rule = calibrate_cameras(**views)
    low, high = rule.bounds_g(views["predicted_g"], views["terms"])
    assert rule.other is None
    assert ((views["weight_g"] >= low) & (views["weight_g"] <= high)).mean() == pytest.approx(0.91, abs=0.03)


def test_more_noise_and_more_holes_are_never_less_unlike_and_a_better_camera_is_not_unlike() -> None:
    rule = Weigher.load().sidecar.interval_rule
    assert rule is not None
    noise_px = np.array([0.001, 0.02, 0.03, 0.05, 0.08, 0.3])
    features = np.full((6, len(NAMES)), 50.0)
    features[:, HOLES] = 0.0
    clean = rule.unlike(noise_px, features)
    assert (np.diff(clean) >= 0).all()
    assert clean[0] == clean[1] < 0.1
    assert clean[-1] > 0.95
    unknown = rule.unlike(np.full(6, np.nan), features)
    assert unknown == pytest.approx(clean[2])
    features[:, HOLES] = [0.0, 0.001, 0.003, 0.01, 0.05, 0.2]
    holed = rule.unlike(np.full(6, 0.03), features)
    assert (np.diff(holed) >= 0).all()
    assert holed[-1] > 0.95


def test_a_noisy_view_is_measured_flagged_and_wider_and_weighs_the_same_kind_of_tuber() -> None:
    view = ellipsoid_view()
    z_m = view.depth * view.depth_scale_m
    strength = view.intrinsics.fx * 0.018
    drawn = np.random.default_rng(SEED).normal(0, 0.1, view.depth.shape)
    noisy_m = strength / (strength / np.maximum(z_m, 0.1) + drawn)
    noisy = replace(view, depth=np.where(view.depth, noisy_m / view.depth_scale_m, 0).astype(np.uint16))
    found = crop_noise_px(noisy.depth, depth_scale_m=view.depth_scale_m, fx=view.intrinsics.fx)
    assert found == pytest.approx(0.1, rel=0.15), f"seed {SEED}"
    weigher = Weigher.load()
    even, rough = (weigher.weigh(prepare_view(one)) for one in (view, noisy))
    assert CAMERA_UNLIKE not in even.flags
    assert CAMERA_UNLIKE in rough.flags
    assert rough.high_g - rough.low_g > 1.2 * (even.high_g - even.low_g)


def test_a_rule_of_other_terms_is_refused() -> None:
    with pytest.raises(ValueError, match="made from"):
        CameraRule.from_json({"terms": ["colour"], "intercept": 0.0, "slopes": [1.0]})
