"""Preparation: the order of the paper, the level frame, cleaning, refusals and flags."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from conveyor.crop_depth import clean_depth
from conveyor.geometry import straight_down_belt_from_camera
from regressor.weigh.pixel_grid import pixel_grid
from regressor.weigh.prepare import (
    MAX_POINTS,
    MISSING,
    PARTS,
    RefusedCloud,
    prepare_cloud,
    prepare_view,
)
from regressor.weigh.widths import DIRECTIONS, TRIMMED
from tests.regressor.all_widths import all_widths
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


def test_steps_of_five_millimetres_are_no_edges() -> None:
    """All pixels next to a step were dropped, and the weight was 29 % less."""
    coarse, fine = (prepare_view(ellipsoid_view(depth_scale_m=scale)) for scale in (0.005, 0.0001))
    assert coarse.surface.volume_ml == pytest.approx(fine.surface.volume_ml, rel=0.02)
    assert len(coarse.points) > 0.95 * len(fine.points)


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


@pytest.mark.parametrize("belt_distance_m", [0.1, 0.288, 0.289, 0.2895])
def test_what_does_not_stand_above_its_belt_is_refused(belt_distance_m: float) -> None:
    """Views and clouds without a top ended in a division by zero, and with it the regressor."""
    view = ellipsoid_view()  # its top is 0.289 m from the camera
    low = replace(view, belt_from_camera=straight_down_belt_from_camera(belt_distance_m))
    cloud = view.points_in_camera_m()
    shuffled = cloud + np.random.default_rng(4).uniform(-1e-3, 0, cloud.shape) * [1, 1, 0]
    assert pixel_grid(shuffled.astype(np.float64)) is None
    for attempt in (
        lambda: prepare_view(low),
        lambda: prepare_cloud(cloud, belt_distance_m=belt_distance_m),
        lambda: prepare_cloud(shuffled, belt_distance_m=belt_distance_m),
        lambda: prepare_view(replace(low, resting_offset_m=-0.01)),
    ):
        with pytest.raises(RefusedCloud, match=r"nearest point is 0\.289 m .* check --belt-distance-m") as refused:
            attempt()
        assert refused.value.reason == "below_belt"
    # The resting level counts, not the belt.
    assert prepare_view(replace(low, resting_offset_m=0.19 + 0.01)).height_m > 0.01
    assert np.isfinite(prepare_view(replace(view, resting_offset_m=-0.0545)).surface.as_array()).all()


def test_a_cloud_in_the_axes_of_opengl_is_told_so() -> None:
    """It had "fewer than 30 points after cleaning", of 6000."""
    turned = ellipsoid_view().points_in_camera_m().astype(np.float64) * [1, -1, -1]
    with pytest.raises(RefusedCloud, match=r"behind the camera, z is below 0: .* turn round those of") as error:
        prepare_cloud(turned, belt_distance_m=0.345)
    assert error.value.reason == "too_few_points"


def test_no_odd_cloud_does_more_than_be_refused() -> None:
    """Points on a heap, on a line, in one's eye, or far out: divisions by zero, overflows, gigabytes."""
    rng = np.random.default_rng(6)
    tuber = ellipsoid_view().points_in_camera_m().astype(np.float64)
    along = np.linspace(-0.03, 0.03, 400)[:, None]
    far_off = [np.array(place) + rng.normal(0, 0.001, (20, 3)) for place in ([900.0, 0.0, 0.3], [0.0, 900.0, 0.3])]
    heavy = np.repeat(tuber, 12, axis=0)
    heavy[0, 0] = 1e300
    weighed = (along * [1, 1, 0.3] + [0, 0, 0.3], np.vstack([tuber, *far_off]))
    refused = {
        "not_finite": (tuber * 1e300, heavy, tuber * 1e5),
        "too_few_points": (tuber * [1, 1, 1e-300], tuber * 1e-6, -tuber, np.tile([0.0, 0.0, 0.3], (400, 1))),
        "below_belt": (tuber * 1000,),
        "not_a_cloud": (None, [[1, 2, 3], [4, 5]], np.full((50, 3), "here"), tuber.astype(complex)),
    }
    with np.errstate(all="raise"):
        for points in weighed:
            assert np.isfinite(prepare_cloud(points, belt_distance_m=0.345).surface.as_array()).all()
        for reason, clouds in refused.items():
            for points in clouds:
                with pytest.raises(RefusedCloud) as error:
                    prepare_cloud(points, belt_distance_m=0.345)  # type: ignore[arg-type]
                assert error.value.reason == reason


@pytest.mark.parametrize("seed", range(3))
def test_no_odd_view_does_more_than_be_refused(seed: int) -> None:
    """Specks, strips and flat patches, on the belt, under it and above it."""
    rng, view = np.random.default_rng(seed), ellipsoid_view()
    for _ in range(200):
        shape = tuple(rng.integers(1, 14, 2))
        z = rng.choice([1, 100, 300, 344, 345, 60000]) + rng.integers(0, rng.choice([1, 3, 60]), shape)
        depth = np.where(rng.random(shape) < rng.choice([0.3, 0.9, 1.0]), z, 0).astype(np.uint16)
        try:
            cloud = prepare_view(replace(view, u0=0, v0=0, depth=depth))
        except RefusedCloud:
            continue
        assert np.isfinite(cloud.surface.as_array()).all()


def test_a_line_of_points_needs_no_more_memory_than_a_tuber() -> None:
    """Cells were as small as the line is thin: 900 m of it asked for 12 TB."""
    places = np.linspace(0, 900, 100)
    cloud = prepare_cloud(np.column_stack([places, 0 * places, 0 * places + 0.0011]), belt_distance_m=0.345)
    assert len(cloud.points) == 100


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
    assert from_cloud.surface.volume_ml == pytest.approx(from_depth.surface.volume_ml, rel=0.01)
    assert from_cloud.surface.area_cm2 == pytest.approx(from_depth.surface.area_cm2, rel=0.01)
    assert np.allclose(view.belt_from_camera, straight_down_belt_from_camera(0.345))


@pytest.mark.parametrize("half_axes_m", [(0.020, 0.018, 0.015), (0.042, 0.033, 0.028), (0.060, 0.050, 0.045)])
@pytest.mark.parametrize("centre_m", [(0.0, 0.0), (0.10, -0.06)])
def test_a_cloud_without_its_image_has_the_volume_of_its_pixels(
    half_axes_m: tuple[float, float, float], centre_m: tuple[float, float]
) -> None:
    """It was 9 % short: cells at the rim counted by how full they were against the fullest."""
    view = ellipsoid_view(half_axes_m, centre_m=centre_m)
    pixels = prepare_view(view).surface
    points = view.points_in_camera_m()
    rng = np.random.default_rng(5)
    for cloud, within in ((points, 0.01), (points[rng.permutation(len(points))[: len(points) * 2 // 3]], 0.02)):
        surface = prepare_cloud(cloud, belt_distance_m=0.345).surface
        assert surface.volume_ml == pytest.approx(pixels.volume_ml, rel=within)


def test_a_cloud_of_millions_is_thinned_out_and_keeps_its_volume() -> None:
    view = ellipsoid_view((0.042, 0.033, 0.028))
    points = np.repeat(view.points_in_camera_m().astype(np.float64), 110, axis=0)
    points += np.random.default_rng(3).uniform(-2.5e-4, 2.5e-4, points.shape)
    cloud = prepare_cloud(points, belt_distance_m=0.345)
    assert len(points) > 2_000_000
    assert len(cloud.points) <= MAX_POINTS
    assert cloud.surface.volume_ml == pytest.approx(prepare_view(view).surface.volume_ml, rel=0.02)


def test_holes_inside_a_mask_cost_no_volume() -> None:
    """12 % of the skin lost in blobs used to cost 10 % of the volume."""
    view = ellipsoid_view((0.042, 0.033, 0.028))
    rng = np.random.default_rng(8)
    depth = view.depth.copy()
    rows, columns = np.ogrid[: depth.shape[0], : depth.shape[1]]
    inside = np.argwhere(depth > 0)
    for v, u in inside[rng.integers(0, len(inside), 45)]:
        depth[(rows - v) ** 2 + (columns - u) ** 2 < 36] = 0
    lost = 1 - (depth > 0).sum() / (view.depth > 0).sum()
    whole, holed = prepare_view(view).surface, prepare_view(replace(view, depth=depth)).surface
    assert lost > 0.15
    assert 0.08 < holed.hole_share < lost
    # What touches the outline is no hole but a bite out of it: it stays lost, and the hull tells.
    assert holed.volume_ml == pytest.approx(whole.volume_ml, rel=0.05)
    assert holed.hull_cm2 == pytest.approx(whole.hull_cm2, rel=0.02)


@pytest.mark.parametrize("every", [2, 3, 4, 5, 1000])
@pytest.mark.parametrize("turned", [False, True])
def test_rows_that_a_camera_left_out_change_no_surface(every: int, turned: bool) -> None:
    """Every k-th row without depth: 8 to 27 % heavy, for each stood at an outline. One: 30 % light, cut in two."""
    view = ellipsoid_view((0.042, 0.033, 0.028))
    depth = view.depth.copy()
    (depth.T if turned else depth)[depth.shape[turned] // 2 % every :: every] = 0
    whole, holed = prepare_view(view), prepare_view(replace(view, depth=depth))
    assert (whole.flags, holed.flags) == ((), (MISSING,))
    assert len(holed.points) == pytest.approx(len(whole.points), rel=0.02)
    for name in ("volume_ml", "area_cm2", "height_mm", "hull_cm2"):
        assert getattr(holed.surface, name) == pytest.approx(getattr(whole.surface, name), rel=0.02)
    assert holed.surface.rim == pytest.approx(whole.surface.rim, abs=0.02)
    np.testing.assert_allclose(holed.surface.profile, whole.surface.profile, rtol=0.05, atol=0.02)


def test_parts_are_weighed_together_and_flagged() -> None:
    """A wide gap through the middle had a line weigh the larger half alone, and call the other one grown."""
    view = ellipsoid_view((0.042, 0.033, 0.028))
    depth = view.depth.copy()
    depth[depth.shape[0] // 2 :][:12] = 0
    whole, parted = prepare_view(view), prepare_view(replace(view, depth=depth))
    assert parted.flags == (PARTS,)
    left = np.count_nonzero(depth) / np.count_nonzero(view.depth)
    assert parted.surface.area_cm2 == pytest.approx(left * whole.surface.area_cm2, rel=0.02)


def test_false_matches_are_cut_off() -> None:
    view = ellipsoid_view((0.042, 0.033, 0.028))
    depth = view.depth.copy()
    middle = np.array(depth.shape) // 2
    depth[middle[0] : middle[0] + 9, middle[1] : middle[1] + 9] -= 60
    cleaned = clean_depth(depth, view.depth_scale_m)
    assert not cleaned[middle[0] : middle[0] + 9, middle[1] : middle[1] + 9].any()
    surface, clean = prepare_view(replace(view, depth=depth)).surface, prepare_view(view).surface
    assert surface.volume_ml == pytest.approx(clean.volume_ml, rel=0.005)
    assert surface.height_mm == pytest.approx(clean.height_mm, abs=0.5)


def test_everything_counts_from_the_resting_level() -> None:
    """A tuber 6 mm below the belt plane that is weighed there is the tuber on the plane."""
    on_plane = prepare_view(ellipsoid_view(belt_distance_m=0.351))
    below = prepare_view(replace(ellipsoid_view(belt_distance_m=0.351), resting_offset_m=0.006))
    stated = replace(
        ellipsoid_view(belt_distance_m=0.351),
        belt_from_camera=straight_down_belt_from_camera(0.345),
        resting_offset_m=0.006,
    )
    assert prepare_view(stated).surface == on_plane.surface
    assert prepare_view(stated).height_m == pytest.approx(on_plane.height_m)
    assert below.height_m == pytest.approx(on_plane.height_m + 0.006)
    deeper_ml = 0.6 * on_plane.surface.area_cm2
    assert below.surface.volume_ml == pytest.approx(on_plane.surface.volume_ml + deeper_ml, rel=1e-6)


@pytest.mark.parametrize("points", [1, 2, 3, 57, 400, 2003])
def test_widths_are_those_of_quantiles(points: int) -> None:
    """Ties included: depths are whole millimetres."""
    xy = np.random.default_rng(points).normal(size=(points, 2)).round(1)
    along = DIRECTIONS[0] * xy[:, :1] + DIRECTIONS[1] * xy[:, 1:]
    widths = np.quantile(along, 1 - TRIMMED, axis=0) - np.quantile(along, TRIMMED, axis=0)
    np.testing.assert_array_equal(all_widths(xy), widths)
