"""Loops of the weighing give the numbers of their plain forms."""

from __future__ import annotations

import numpy as np

from conveyor.depth_noise import JUMP_PX, LEAST_SEEN, SIDE, _windows
from regressor.weigh.completed import _directions, _extremes, _reach_mm, _turned
from regressor.weigh.prepare import _centred
from regressor.weigh.surface import _quadric, _quantiles

RNG = np.random.default_rng(7)


def test_extremes_and_reaches_are_those_of_numpy() -> None:
    """Also where several points lie equally far: the first one counts."""
    points, directions = np.round(RNG.normal(size=(400, 3)), 1), _directions()[0].T
    along = points @ directions
    extremes = np.unique(np.concatenate([along.argmax(axis=0), along.argmin(axis=0)]))
    np.testing.assert_array_equal(np.flatnonzero(_extremes(points, np.ascontiguousarray(directions))), extremes)
    np.testing.assert_array_equal(_reach_mm(along), 2000 * np.abs(along).max(axis=0))


def test_square_holes_are_turned_as_in_the_plain_form() -> None:
    u, v = np.linalg.qr(RNG.normal(size=(3, 2)))[0].T
    w = np.cross(u, v)
    a, b, c = (0.05 * n.ravel() for n in np.meshgrid(*[(-1.0, 0.0, 1.0)] * 3))
    first = u + c[:, None] * v - b[:, None] * w
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = v - c[:, None] * u + a[:, None] * w
    second -= (second * first).sum(axis=1, keepdims=True) * first
    second /= np.linalg.norm(second, axis=1, keepdims=True)
    np.testing.assert_array_equal(_turned(u, v, 0.05), np.stack([first, second], axis=1))


def test_the_top_is_fitted_by_least_squares() -> None:
    xy, heights = RNG.normal(0, 0.02, (500, 2)), RNG.uniform(0.03, 0.05, 500)
    x, y = ((xy - xy.mean(0)) / 0.03).T
    design = np.column_stack([np.ones(500), x, y, x * x, x * y, y * y])
    plain = np.linalg.solve(design.T @ design + 1e-6 * 500 * np.eye(6), design.T @ heights)
    np.testing.assert_allclose(_quadric(xy, heights, 0.03), plain, rtol=1e-10)


def test_a_cloud_is_centred_on_the_mean_of_its_points() -> None:
    level = RNG.normal(0.4, 0.03, (700, 3))
    points, centre, box = _centred(level)
    plain = level.astype(np.float32)
    middle = plain.mean(axis=0, dtype=np.float64).astype(np.float32)
    np.testing.assert_array_equal(centre, middle)
    np.testing.assert_array_equal(points, plain - middle)
    np.testing.assert_array_equal(box, np.ptp(plain - middle, axis=0))


def test_quantiles_are_those_of_numpy() -> None:
    for n in (1, 2, 3, 11, 400, 1501):
        values = RNG.normal(size=n)
        shares = (0.0, 0.005, 0.1, 0.5, 0.9, 0.99, 1.0)
        np.testing.assert_array_equal(_quantiles(np.sort(values), shares), np.quantile(values, shares))


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
