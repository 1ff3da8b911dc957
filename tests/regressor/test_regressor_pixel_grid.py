"""A cloud that was made of a depth image is that image again, and weighs what it weighs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from conveyor.formats.clouds import read_cloud
from regressor.weigh.pixel_grid import pixel_grid
from regressor.weigh.prepare import prepare_cloud, prepare_view
from tests.regressor.ellipsoids import ellipsoid_view

SEED = 11
BELT_M = 0.345


def _view_and_cloud(unit_m: float, kind: type[np.floating]) -> tuple:
    """A view of an ellipsoid, and its pixels as points in no order."""
    view = ellipsoid_view(depth_scale_m=unit_m, centre_m=(0.03, -0.02), belt_distance_m=BELT_M)
    k = view.intrinsics
    v, u = np.nonzero(view.depth)
    z = view.depth[v, u] * unit_m
    points = np.stack([(u + view.u0 - k.cx) * z / k.fx, (v + view.v0 - k.cy) * z / k.fy, z], axis=1)
    order = np.random.default_rng(SEED).permutation(len(points))
    return view, points[order].astype(kind).astype(np.float64)


@pytest.mark.parametrize("unit_m", [1e-3, 1e-4])
@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_the_image_comes_back(unit_m: float, kind: type[np.floating]) -> None:
    view, points = _view_and_cloud(unit_m, kind)
    grid = pixel_grid(points)
    assert grid is not None
    assert grid.depth_scale_m == unit_m
    assert np.array_equal(grid.depth, view.depth)
    assert (grid.fx, grid.fy) == pytest.approx((view.intrinsics.fx, view.intrinsics.fy), rel=1e-6)
    assert (grid.cx, grid.cy) == pytest.approx((view.intrinsics.cx - view.u0, view.intrinsics.cy - view.v0), abs=1e-3)
    by_image, by_cloud = prepare_view(view), prepare_cloud(points, belt_distance_m=BELT_M)
    assert by_cloud.surface.as_array() == pytest.approx(by_image.surface.as_array(), rel=1e-4, abs=1e-6)
    assert by_cloud.noise_px == pytest.approx(by_image.noise_px, rel=1e-4)
    assert by_cloud.height_m == pytest.approx(by_image.height_m, abs=1e-7)
    assert len(by_cloud.points) == len(by_image.points)


@pytest.mark.parametrize("unit_m", [1e-3, 1e-4])
@pytest.mark.parametrize("decimals", [5, 4])
def test_points_with_few_decimals_are_the_image_too(unit_m: float, decimals: int) -> None:
    """The step was a little short, and over a tuber's width a pixel too many: such a file weighed 3 % less."""
    view, points = _view_and_cloud(unit_m, np.float64)
    grid = pixel_grid(np.round(points, decimals))
    assert grid is not None
    assert np.array_equal(grid.depth, view.depth)
    assert (grid.fx, grid.fy) == pytest.approx((view.intrinsics.fx, view.intrinsics.fy), rel=2e-4)


def test_points_in_half_precision_are_nearly_the_image() -> None:
    view, points = _view_and_cloud(1e-3, np.float16)
    grid = pixel_grid(points)
    assert grid is not None
    assert np.array_equal(grid.depth > 0, view.depth > 0)
    volume_ml = prepare_cloud(points, belt_distance_m=BELT_M).surface.volume_ml
    assert volume_ml == pytest.approx(prepare_view(view).surface.volume_ml, rel=0.01)


@pytest.mark.parametrize("scattered_m", [0.0, 2e-5])
def test_points_that_stand_in_a_cloud_twice_count_once(scattered_m: float) -> None:
    """Two merged scans, of which one is a copy, made another density, and so other pixels: 4 % off at most."""
    _, points = _view_and_cloud(1e-3, np.float64)
    points += np.random.default_rng(SEED).normal(0, scattered_m, points.shape)
    once, twice, some = (
        prepare_cloud(cloud, belt_distance_m=BELT_M)
        for cloud in (points, np.repeat(points, 2, axis=0), np.concatenate([points, points[:500]]))
    )
    for cloud in (twice, some):
        assert cloud.surface == once.surface
        assert np.array_equal(cloud.points, once.points)


def test_depths_of_no_unit_keep_a_hundredth_of_a_millimetre() -> None:
    _, points = _view_and_cloud(1e-4, np.float64)
    points *= 1 + 1e-3 * np.random.default_rng(SEED).uniform(-1, 1, (len(points), 1))
    grid = pixel_grid(points)
    assert grid is not None
    assert grid.depth_scale_m == 1e-5
    assert np.sort(grid.depth[grid.depth > 0] * 1e-5) == pytest.approx(np.sort(points[:, 2]), abs=5.1e-6)


def test_what_is_no_camera_image_is_none() -> None:
    rng = np.random.default_rng(SEED)
    _, points = _view_and_cloud(1e-3, np.float64)
    scattered = points + rng.normal(0, 2e-4, points.shape)
    for name, cloud in {
        "random": rng.uniform([-0.03, -0.03, 0.28], [0.03, 0.03, 0.34], (5000, 3)),
        "scattered": scattered,
        "two points in a pixel": np.concatenate([points, points[:50] * 1.01]),
        "behind the camera": points * [1, 1, -1],
        "two of three pixels": points[: 2 * len(points) // 3],
        "few": points[:20],
        "one column": points[np.abs(points[:, 0] / points[:, 2] - points[0, 0] / points[0, 2]) < 1e-9],
    }.items():
        assert pixel_grid(cloud) is None, name
    assert pixel_grid(points * 10) is not None, "3 m in millimetres is within 16 bits"
    assert pixel_grid(points * 1000) is None, "300 m is not"


def test_every_fifth_pixel_is_a_coarser_camera() -> None:
    """Thinned in the image, not at random: columns and rows are still a whole number of steps apart."""
    view, points = _view_and_cloud(1e-3, np.float64)
    k = view.intrinsics
    u, v = np.round(points[:, 0] / points[:, 2] * k.fx + k.cx), np.round(points[:, 1] / points[:, 2] * k.fy + k.cy)
    grid = pixel_grid(points[(u % 5 == 0) & (v % 5 == 0)])
    assert grid is not None
    assert grid.fx == pytest.approx(k.fx / 5, rel=1e-6)


def test_the_real_partial_cloud_is_its_cameras_image(shared: Path) -> None:
    """The whole tuber's 20,000 points are no camera's; the partial cloud's are."""
    ply = shared / "data" / "potatotwin_sample" / "R9-9_20000.ply"
    if not ply.is_file():
        pytest.skip(f"the real cloud is not at {ply}")
    assert pixel_grid(np.asarray(read_cloud(ply), np.float64)) is None
    seen = pixel_grid(np.asarray(read_cloud(ply.with_name("R9-9_pcd_365.ply")), np.float64))
    assert seen is not None
    assert seen.depth_scale_m == 1e-3
    assert (seen.fx, seen.fy) == pytest.approx((653.76, 652.12), abs=0.01)
