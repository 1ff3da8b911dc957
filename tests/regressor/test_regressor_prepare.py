"""Preparation: the order of the paper, the level frame, cleaning, refusals and flags."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from conveyor.geometry import straight_down_belt_from_camera
from regressor.weigh.prepare import RefusedCloud, clean_depth, prepare_cloud, prepare_view
from tests.regressor.ellipsoids import ellipsoid_view


def test_height_comes_from_the_raw_cloud_and_the_mean_is_zero() -> None:
    cloud = prepare_view(ellipsoid_view((0.042, 0.033, 0.028)))
    assert cloud.height_m == pytest.approx(0.056, abs=6e-4)
    assert np.abs(cloud.points.mean(0)).max() < 1e-6
    assert cloud.belt_distance_m == 0.345
    assert cloud.flags == ()


def test_tenths_of_a_millimetre_give_the_same_cloud() -> None:
    coarse, fine = (prepare_view(ellipsoid_view(depth_scale_m=scale)) for scale in (0.001, 0.0001))
    assert fine.height_m == pytest.approx(coarse.height_m, abs=6e-4)
    assert fine.surface.volume_ml == pytest.approx(coarse.surface.volume_ml, rel=5e-3)


def test_visible_volume_of_an_ellipsoid() -> None:
    """Down to the belt and inside the outline: half an ellipsoid on a cylinder, seen from far enough."""
    a, b, c = 0.042, 0.033, 0.028
    expected_ml = 1e6 * (2 / 3 * np.pi * a * b * c + np.pi * a * b * c)
    view = ellipsoid_view((a, b, c), belt_distance_m=2.0, depth_scale_m=0.0001)
    assert prepare_view(view).surface.volume_ml == pytest.approx(expected_ml, rel=0.05)


@pytest.mark.parametrize("tilt_deg", [4.0, -10.0])
def test_a_tilted_camera_sees_the_same_level_tuber(tilt_deg: float) -> None:
    straight = prepare_view(ellipsoid_view(depth_scale_m=0.0001))
    tilted = prepare_view(ellipsoid_view(depth_scale_m=0.0001, tilt_deg=tilt_deg))
    assert tilted.height_m == pytest.approx(straight.height_m, abs=3e-4)
    assert tilted.belt_distance_m == pytest.approx(0.345)
    assert np.ptp(tilted.points, axis=0) == pytest.approx(np.ptp(straight.points, axis=0), abs=2e-3)
    assert tilted.surface.volume_ml == pytest.approx(straight.surface.volume_ml, rel=0.02)


def test_cleaning_drops_strays_and_keeps_the_tuber() -> None:
    view = ellipsoid_view()
    depth = view.depth.copy()
    inside = np.argwhere(depth > 0)
    for v, u in inside[:: len(inside) // 20]:
        depth[v, u] -= 30
    cleaned = clean_depth(depth, view.depth_scale_m)
    clean = clean_depth(view.depth, view.depth_scale_m)
    assert prepare_view(replace(view, depth=depth)).height_m == pytest.approx(prepare_view(view).height_m, abs=2e-3)
    assert (clean > 0).sum() > 0.98 * (view.depth > 0).sum()
    assert (cleaned > 0).sum() > 0.95 * (view.depth > 0).sum()


@pytest.mark.parametrize(
    ("depth", "reason"),
    [(np.zeros((40, 40), np.uint16), "empty_cloud"), (np.pad(np.full((3, 3), 300, np.uint16), 9), "too_few_points")],
)
def test_views_that_cannot_be_weighed_are_refused(depth: np.ndarray, reason: str) -> None:
    with pytest.raises(RefusedCloud) as refused:
        prepare_view(replace(ellipsoid_view(), depth=depth))
    assert refused.value.reason == reason


def test_clouds_that_cannot_be_weighed_are_refused() -> None:
    cloud = np.zeros((100, 3))
    cloud[3, 1] = np.nan
    for points, reason in ((np.empty((0, 3)), "empty_cloud"), (cloud, "not_finite"), (cloud[:, :2], "not_a_cloud")):
        with pytest.raises(RefusedCloud) as refused:
            prepare_cloud(points, belt_distance_m=0.345)
        assert refused.value.reason == reason


def test_unusual_clouds_are_flagged() -> None:
    small = prepare_view(ellipsoid_view((0.009, 0.008, 0.008)))
    tall = prepare_view(ellipsoid_view((0.06, 0.05, 0.045)))
    wide = prepare_view(ellipsoid_view((0.12, 0.03, 0.03)))
    assert small.flags == ("few_points",)
    assert tall.height_m == pytest.approx(0.09, abs=6e-4)
    assert tall.clamped_height_m() == 0.08
    assert tall.clamped_height_m(0.16) == tall.height_m
    assert "extent" in wide.flags


def test_a_cloud_file_and_its_depth_image_agree() -> None:
    view = ellipsoid_view()
    from_depth = prepare_view(view)
    from_cloud = prepare_cloud(view.points_in_camera_m(), belt_distance_m=0.345)
    assert from_cloud.height_m == pytest.approx(from_depth.height_m, abs=1e-6)
    assert from_cloud.surface.volume_ml == pytest.approx(from_depth.surface.volume_ml, rel=0.08)
    assert np.allclose(view.belt_from_camera, straight_down_belt_from_camera(0.345))
