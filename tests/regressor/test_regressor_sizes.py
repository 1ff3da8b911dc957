"""Sizes of the whole tuber from one view: the completed body, the shipped rules, what they say of themselves."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from camera_sim.sim.meshes import random_rotation
from camera_sim.sim.view_setting import ViewPlan
from camera_sim.sim.views import ViewSimulator
from conveyor.errors import InputError
from conveyor.geometry import straight_down_belt_from_camera
from conveyor.messages import Sizes
from conveyor.messages.sizes import MEASURES
from regressor.weigh.completed import completed_sizes_mm
from regressor.weigh.prepare import prepare_cloud, prepare_depth
from regressor.weigh.sizes import SHIPPED, SizeRules, fit_sizes, load_rules, size_features
from regressor.weigh.weigher import Weigher

SEED = 20261123


def test_the_visible_half_of_an_ellipsoid_gives_all_of_it() -> None:
    """Seen from far in any pose, with only what is lower than 0.4 of its height left out."""
    rng = np.random.default_rng(SEED)
    axes = np.array([84.0, 58.0, 46.0])
    for turn in (np.eye(3), random_rotation(rng)):
        form = turn @ np.diag((2000 / axes) ** 2) @ turn.T
        height_m, distance_m = 2 * float(np.sqrt(np.linalg.inv(form)[2, 2])), 30.0
        x, y = (side.ravel() for side in np.meshgrid(*[np.arange(-0.05, 0.05, 0.0008)] * 2))
        across = form[0, 2] * x + form[1, 2] * y
        inside = across**2 - form[2, 2] * (form[0, 0] * x * x + 2 * form[0, 1] * x * y + form[1, 1] * y * y - 1)
        x, y, across, inside = (side[inside > 0] for side in (x, y, across, inside))
        top = (np.sqrt(inside) - across) / form[2, 2]
        seen = np.column_stack([x, y, distance_m - height_m / 2 - top])
        found = completed_sizes_mm(seen, distance_m=distance_m, height_m=height_m)
        expected = (*axes, np.hypot(axes[1], axes[2]) / np.sqrt(2))
        assert found == pytest.approx(expected, rel=0.035), f"seed {SEED}"


def test_simulated_views_are_sized_and_their_intervals_hold() -> None:
    """Views of 30 tubers of a world that the rules were fitted on, of another seed."""
    weigher = Weigher.load()
    simulator = ViewSimulator(ViewPlan(SEED, 1, "field"))
    errors, held = [], []
    for number in range(30):
        for view in simulator.views(number):
            k = view.intrinsics
            cloud = prepare_depth(
                view.depth,
                depth_scale_m=view.depth_scale_m,
                fx=k.fx,
                fy=k.fy,
                cx=k.cx - view.u0,
                cy=k.cy - view.v0,
                belt_from_camera=straight_down_belt_from_camera(view.belt_distance_m),
            )
            sizes = weigher.weigh(cloud, belt_sd_m=view.belt_sd_m).sizes
            assert sizes is not None
            assert sizes.length_mm >= sizes.width_mm >= sizes.thickness_mm > 0
            truth = dict(zip(MEASURES, (*view.tuber.axes_mm, view.tuber.square_mesh_mm), strict=True))
            errors.append([sizes.of(name)[0] - truth[name] for name in MEASURES])
            held += [low <= truth[n] <= high for n in MEASURES for low, high in [sizes.interval_mm(n)]]
    off = np.median(np.abs(errors), axis=0)
    assert off[3] < 2.5, f"seed {SEED}: {off}"
    assert (off < 4.5).all(), f"seed {SEED}: {off}"
    assert np.mean(held) > 0.75, f"seed {SEED}: {np.mean(held)}"


def test_what_is_hardly_higher_than_its_belt_has_a_body_all_the_same() -> None:
    """It was completed as 5 mm high, of which no point lies in the upper part: sizes were those of no body, 100 mm long
    to 3 mm, and the compiled loop wrote beyond an empty array.
    """
    x, y = (side.ravel() for side in np.meshgrid(*[np.linspace(-0.02, 0.02, 40)] * 2))
    flat = prepare_cloud(np.column_stack([x, y, 0.3435 + x * x]), belt_distance_m=0.345)
    length, width, thickness, _ = size_features(flat)[-4:]
    assert (length, width, thickness) == pytest.approx((np.hypot(40, 40), np.hypot(40, 40), 1.5), abs=0.1)


def test_rules_come_back_from_their_file_and_others_are_refused(tmp_path: Path) -> None:
    rules = load_rules()
    assert SizeRules.from_json(json.loads(json.dumps(rules.to_json()))) == rules
    other = tmp_path / "rules.json"
    other.write_text(SHIPPED.read_text().replace("tuberline-sizes/1", "tuberline-sizes/9"))
    with pytest.raises(InputError, match="tuberline-sizes/9"):
        load_rules(other)


def test_a_fit_finds_sizes_that_follow_from_features() -> None:
    rng = np.random.default_rng(SEED)
    features = rng.uniform(20.0, 90.0, (400, 21))
    sizes = np.column_stack([features[:, 17], features[:, 18], features[:, 19], 0.7 * features[:, 18] + 0.3 * 40])
    rules = fit_sizes(features, sizes, rng.uniform(0.0, 1.0, (400, 6)), farthest_m=0.5)
    near, edge, far = (rules.sizes(features[0], np.full(6, 0.5), distance_m=m) for m in (0.3, 0.5, 1.0))
    assert near == edge, "as far as the fit saw"
    assert (far.mesh_mm, far.mesh_sd_mm) == pytest.approx((near.mesh_mm, 2**0.8 * near.mesh_sd_mm), abs=0.002)
    value, sd = rules.rules["length"].sizes_mm(features[:5], np.full((5, 6), 0.5))
    assert value == pytest.approx(sizes[:5, 0], rel=0.03)
    assert (sd > 0).all()
    # Rows that say something else and weigh nothing change nothing.
    twice, other = np.vstack([features, features]), np.vstack([sizes, 2 * sizes])
    weighed = fit_sizes(twice, other, rng.uniform(0.0, 1.0, (800, 6)), np.repeat([1.0, 0.0], 400))
    said, before = (found.rules["mesh"].value.values(features) for found in (weighed, rules))
    assert said == pytest.approx(before, abs=0.01), "ln mm; alike they would be 0.35 more"


def test_an_interval_is_never_below_zero() -> None:
    assert Sizes(9, 8, 7, 7, 1, 1, 1, 10).interval_mm("mesh")[0] == 0.0
