"""Loops of the weighing give the numbers of their plain forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from conveyor.crop_depth import fill_holes
from conveyor.depth_noise import JUMP_PX, LEAST_SEEN, SIDE, _residuals, _tuber, _windows, disparity
from regressor.network.sampling import farthest_points
from regressor.weigh.completed import LEAST_HEIGHT, _about_middle, _directions, _extremes, _reach_mm, _turned
from regressor.weigh.grown import view_heights_m
from regressor.weigh.prepare import _areas, _centred, _points
from regressor.weigh.quadratic import pairs_of, quadratic
from regressor.weigh.surface import (
    CURVATURE_POINTS,
    LEVELS,
    _quadric,
    _quantiles,
    _ranked,
    _rim,
    _sums,
    _top,
)
from regressor.weigh.widths import DIRECTIONS, longest_widths
from tests.regressor.all_widths import all_widths
from tests.regressor.ellipsoids import ellipsoid_view

RNG = np.random.default_rng(7)


def test_extremes_and_reaches_are_those_of_numpy() -> None:
    """As far as the last bit of a product, which is the processor's: the farthest each way, and no more of them."""
    points, directions = np.round(RNG.normal(size=(400, 3)), 1), _directions()[0]
    along = points @ directions
    extremes = np.unique(np.concatenate([along.argmax(axis=0), along.argmin(axis=0)]))
    found = np.flatnonzero(_extremes(points, directions))
    np.testing.assert_allclose(along[found].max(axis=0), along.max(axis=0), rtol=0, atol=1e-12)
    np.testing.assert_allclose(along[found].min(axis=0), along.min(axis=0), rtol=0, atol=1e-12)
    assert abs(len(found) - len(extremes)) <= 4
    np.testing.assert_allclose(_reach_mm(points, directions), 2000 * np.abs(along).max(axis=0), rtol=1e-13)


def test_points_are_seen_from_the_middle_of_the_body() -> None:
    level = RNG.normal([0.1, -0.2, 0.4], 0.01, (500, 3))
    distance_m, height_m = 0.43, 0.05
    middle_z = distance_m - height_m / 2
    middle = (level[:, :2] / level[:, 2:]).mean(axis=0) * middle_z * (1 - (height_m / 2 / middle_z) ** 2)
    high = distance_m - level[:, 2] > LEAST_HEIGHT * height_m
    assert 0 < high.sum() < 500
    plain = level[high] - np.array([*middle, middle_z])
    np.testing.assert_allclose(_about_middle(level, distance_m, height_m), plain, rtol=0, atol=1e-15)


def test_square_holes_are_turned_as_in_the_plain_form() -> None:
    u, v = np.linalg.qr(RNG.normal(size=(3, 2)))[0].T
    w = np.cross(u, v)
    a, b, c = (0.05 * n.ravel() for n in np.meshgrid(*[(-1.0, 0.0, 1.0)] * 3))
    first = u + c[:, None] * v - b[:, None] * w
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = v - c[:, None] * u + a[:, None] * w
    second -= (second * first).sum(axis=1, keepdims=True) * first
    second /= np.linalg.norm(second, axis=1, keepdims=True)
    np.testing.assert_array_equal(_turned(u, v, 0.05), np.stack([first, second], axis=1).reshape(54, 3).T)


def test_the_top_is_fitted_by_least_squares() -> None:
    xy, heights = RNG.normal(0, 0.02, (500, 2)), RNG.uniform(0.03, 0.05, 500)
    x, y = ((xy - xy.mean(0)) / 0.03).T
    design = np.column_stack([np.ones(500), x, y, x * x, x * y, y * y])
    plain = np.linalg.solve(design.T @ design + 1e-6 * 500 * np.eye(6), design.T @ heights)
    np.testing.assert_allclose(_quadric(xy, heights, 0.03), plain, rtol=1e-10)


def test_a_cloud_is_centred_on_the_mean_of_its_measured_points() -> None:
    level, measured = RNG.normal([0.1, -0.2, 0.4], 0.02, (500, 3)), RNG.random(500) < 0.8
    points, centre, box, nearest_m = _centred(level, measured)
    own = level[measured].astype(np.float32)
    np.testing.assert_array_equal(
        centre, [np.float32(np.cumsum(column.astype(float))[-1] / len(own)) for column in own.T]
    )
    np.testing.assert_array_equal(points, own - centre)
    np.testing.assert_array_equal(box, points.max(0) - points.min(0))
    assert nearest_m == level[measured, 2].min()


def test_pixels_become_points_and_areas() -> None:
    """As by NumPy's index arrays."""
    kept = RNG.integers(0, 3, (20, 30)).astype(np.uint16) * np.uint16(400)
    filled = np.where(RNG.random(kept.shape) < 0.2, 0.5, kept * 0.001)
    inside, measured, places = _points(filled, kept, 600.0, 610.0, 14.5, 9.5)
    v, u = np.nonzero(filled > 0)
    z = filled[v, u]
    np.testing.assert_array_equal(inside, filled > 0)
    np.testing.assert_array_equal(measured, kept[v, u] > 0)
    np.testing.assert_array_equal(places, np.stack([(u - 14.5) * z / 600.0, (v - 9.5) * z / 610.0, z], axis=1))
    level = places + RNG.normal(0, 0.3, places.shape)
    plain = z * z / (600.0 * 610.0) / np.maximum(level[:, 2] / z, 0.2)
    np.testing.assert_array_equal(_areas(places, level, 600.0 * 610.0), plain)


def test_the_longest_axis_is_found_among_all() -> None:
    """Also of a disc, all of whose widths are alike."""
    for stretch in (1.0, 1.02, 2.0):
        xy = np.round(RNG.normal(size=(2, 900)) * np.array([[stretch], [1.0]]), 2)
        x, y = xy / np.hypot(*xy).max() if stretch < 1.5 else xy
        along = DIRECTIONS[0][:, None] * x + DIRECTIONS[1][:, None] * y
        widths = np.quantile(along, 0.995, axis=1) - np.quantile(along, 0.005, axis=1)
        np.testing.assert_array_equal(all_widths(np.stack([x, y], axis=1)), widths)
        longest = int(widths.argmax())
        assert longest_widths(np.stack([x, y], axis=1)) == (widths[longest], widths[(longest + 18) % 36])


def test_areas_volume_and_middles_are_sums_over_the_pixels() -> None:
    level, areas = RNG.normal([0.1, -0.2, 0.4], 0.02, (900, 3)), RNG.uniform(0.5e-6, 1e-6, 900)
    for heights in (RNG.uniform(-0.002, 0.05, 900), RNG.uniform(-0.05, -0.01, 900)):
        top = heights >= min(LEVELS[-1] * 0.05, heights.max())
        plain = [
            *(areas.sum(), (np.maximum(heights, 0) * areas).sum()),
            *(areas @ level[:, :2] / areas.sum()),
            *(areas[top] @ level[top, :2] / areas[top].sum()),
            *(areas[heights > share * 0.05].sum() for share in LEVELS),
        ]
        np.testing.assert_allclose(_sums(level, areas, heights, 0.05), plain, rtol=1e-12)


def test_the_rim_is_what_has_a_neighbour_outside_or_lies_at_the_border() -> None:
    inside = RNG.random((40, 30)) < 0.8
    inside[10:30, 5:20] = True
    rim = inside.copy()
    rim[1:-1, 1:-1] &= ~(inside[:-2, 1:-1] & inside[2:, 1:-1] & inside[1:-1, :-2] & inside[1:-1, 2:])
    assert 0 < rim.sum() < inside.sum()
    level, heights = RNG.normal(0.2, 0.02, (inside.sum(), 3)), RNG.uniform(0, 0.05, inside.sum())
    found, places = _rim(inside, level, heights)
    np.testing.assert_array_equal(found, heights[rim[inside]])
    own = level[rim[inside], :2]
    np.testing.assert_allclose(places, own - own.mean(0), rtol=0, atol=1e-8)


def test_a_quadratic_rule_is_a_sum_over_terms_and_their_pairs() -> None:
    terms, low, high = RNG.normal(size=(5, 7)), np.full(7, -1.0), np.linspace(-1.0, 1.0, 7)  # the first is flat
    coefficients, products = RNG.normal(size=7), RNG.normal(size=28)
    plain = terms @ coefficients + pairs_of(terms, low, high) @ products
    np.testing.assert_allclose(quadratic(terms, low, high, coefficients, products), plain, rtol=1e-12)


def test_heights_of_a_view_are_those_of_its_points() -> None:
    """Of a tilted camera, over a resting level."""
    pose = np.array([[1.0, 0, 0, 0], [0, 0.98, -0.199, 0.1], [0.02, -0.199, -0.98, 0.46], [0, 0, 0, 1]])
    view = replace(ellipsoid_view(), belt_from_camera=pose, resting_offset_m=0.006)
    v, u = np.nonzero(view.depth)
    z, k = view.depth[v, u] * view.depth_scale_m, view.intrinsics
    points = np.stack([(u + view.u0 - k.cx) * z / k.fx, (v + view.v0 - k.cy) * z / k.fy, z, np.ones_like(z)])
    np.testing.assert_allclose(view_heights_m(view.depth, view)[v, u], pose[2] @ points + 0.006, rtol=0, atol=1e-12)


def test_the_top_is_thinned_evenly() -> None:
    xy, heights = RNG.normal(size=(20_000, 2)), RNG.uniform(0, 1, 20_000)
    chosen = np.flatnonzero(heights > 0.3)
    chosen = chosen[:: len(chosen) // CURVATURE_POINTS]
    places, high = _top(xy, heights, 0.3)
    np.testing.assert_array_equal(places, xy[chosen])
    np.testing.assert_array_equal(high, heights[chosen])


def test_a_tuber_s_disparity_begins_at_its_own_first_pixel() -> None:
    depth = np.zeros((30, 40), np.uint16)
    depth[7:21, 9:33] = RNG.integers(0, 2, (14, 24)) * RNG.integers(380, 460, (14, 24))
    depth[7, 20] = depth[20, 11] = depth[12, 9] = depth[13, 32] = 400
    found, count = _tuber(depth, 18.0)
    plain = disparity(depth[7:21, 9:33], depth_scale_m=0.001, focal_baseline=0.018)
    np.testing.assert_array_equal(found, plain)
    assert count == np.count_nonzero(depth)
    assert _tuber(np.zeros((3, 4), np.uint16), 18.0)[1] == 0


def test_quantiles_are_those_of_numpy() -> None:
    for n in (1, 2, 3, 11, 400, 1501):
        values = RNG.normal(size=n)
        shares = (0.0, 0.005, 0.1, 0.5, 0.9, 0.99, 1.0)
        np.testing.assert_array_equal(_quantiles(np.sort(values), shares), np.quantile(values, shares))


def test_a_quantile_needs_no_sorting() -> None:
    for n in (1, 2, 7, 100):
        values = RNG.normal(size=n)
        assert _quantiles(_ranked(values, 0.99), (0.99,)) == [np.quantile(values, 0.99)]


def test_windows_are_those_that_lie_on_one_surface() -> None:
    d = (30 + RNG.normal(0, 0.2, (90, 70))).astype(np.float32)
    d[RNG.random(d.shape) < 0.3] = 0
    d[:30, :30] = 0
    d[60:, 40:] += 2.0  # an outline
    plain = []
    for window in np.lib.stride_tricks.sliding_window_view(d, (SIDE, SIDE))[::7, ::7].reshape(-1, SIDE, SIDE):
        seen = window > 0
        down, across = np.abs(np.diff(window, axis=0)), np.abs(np.diff(window, axis=1))
        jump = max(down[seen[1:] & seen[:-1]].max(initial=0), across[seen[:, 1:] & seen[:, :-1]].max(initial=0))
        if seen.mean() >= LEAST_SEEN and jump < JUMP_PX:
            plain.append(window.ravel())
    assert 10 < len(plain) < 90
    np.testing.assert_array_equal(_windows(d, 7), np.array(plain, np.float64))


def test_what_is_left_beside_a_window_s_quadric_is_that_of_least_squares() -> None:
    y, x = np.mgrid[:SIDE, :SIDE].reshape(2, -1) / (SIDE // 2) - 1.0
    basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    windows = 30 + basis @ RNG.normal(0, 0.3, 6) + RNG.normal(0, 0.05, (40, SIDE * SIDE))
    windows[10:][RNG.random((30, SIDE * SIDE)) < 0.4] = 0
    plain = []
    for window in windows:
        seen = window > 0
        left = window[seen] - basis[seen] @ np.linalg.lstsq(basis[seen], window[seen], rcond=None)[0]
        plain.append(np.sqrt((left @ left) / (seen.sum() - 6)))
    np.testing.assert_allclose(_residuals(windows), plain, rtol=1e-9)
    assert len(_residuals(windows[:0])) == 0


def test_holes_are_filled_along_rows_and_columns() -> None:
    """The mean of both interpolations, each by how narrow the hole is there; what is open to the side stays empty."""
    depth = RNG.uniform(0.3, 0.4, (24, 31))
    depth[RNG.random(depth.shape) < 0.2] = 0
    depth[8:14, 10:17] = 0
    depth[:4, 20:26] = 0
    outside = _reached_from_the_side(depth == 0)
    plain, holes = depth.copy(), np.argwhere((depth == 0) & ~outside)
    for v, u in holes:
        total = weight = 0.0
        for line, at in ((depth[v], u), (depth[:, u], v)):
            seen = np.flatnonzero(line)
            low, high = seen[seen < at][-1], seen[seen > at][0]
            share = 1 / (high - low)
            total += share * (line[low] * (high - at) + line[high] * (at - low)) / (high - low)
            weight += share
        plain[v, u] = total / weight
    assert 50 < len(holes) < np.count_nonzero(depth == 0)
    assert fill_holes(depth) == len(holes)
    np.testing.assert_array_equal(depth, plain)
    assert fill_holes(depth) == 0


def _reached_from_the_side(empty: NDArray[np.bool_]) -> NDArray[np.bool_]:
    reached = empty.copy()
    reached[1:-1, 1:-1] = False
    while True:
        framed = np.pad(reached, 1)
        more = empty & (framed[:-2, 1:-1] | framed[2:, 1:-1] | framed[1:-1, :-2] | framed[1:-1, 2:] | reached)
        if (more == reached).all():
            return reached
        reached = more


def test_the_farthest_points_are_those_of_a_search_through_all() -> None:
    """Blocks that lie too far off are passed by; of equally far points the first is taken, within and across blocks."""
    rows, columns = np.mgrid[0:23, 0:41] * 0.0015
    surface = np.stack([rows, columns, 0.02 * np.sin(40 * rows) + 0.01 * columns], axis=2).reshape(-1, 3)
    flat = np.stack([rows, columns, 0 * rows], axis=2).reshape(-1, 3)
    clouds = [surface, RNG.permutation(surface), flat, RNG.normal(0, 0.03, (333, 3)), np.zeros((70, 3)), flat[:1]]
    for cloud in clouds:
        points = cloud.astype(np.float32)
        for start in {0, len(points) // 2}:
            near, picked = np.full(len(points), np.inf, np.float32), [start]
            for _ in range(min(len(points), 200) - 1):
                apart = points - points[picked[-1]]
                squares = apart * apart
                near = np.minimum(near, squares[:, 0] + squares[:, 1] + squares[:, 2])
                picked.append(int(near.argmax()))
            assert farthest_points(points, len(picked), start=start).tolist() == picked
