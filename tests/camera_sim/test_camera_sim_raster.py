"""The z-buffer against a sphere that can be computed by hand."""

from __future__ import annotations

import numpy as np

from camera_sim.sim.meshes import icosphere
from camera_sim.sim.optics import D405_848
from camera_sim.sim.raster import Window, canvas_over, draw, whole_image

K = D405_848.intrinsics


def _scene(window: Window) -> tuple[np.ndarray, np.ndarray]:
    """(depth, ids) of two spheres, the nearer one partly before the other, before a wall at 0.5 m."""
    directions, faces = icosphere(4)
    canvas = canvas_over(np.full((window.height, window.width), 0.5, np.float32), window)
    for instance, centre in ((1, [0.02, 0.01, 0.42]), (2, [0.05, 0.01, 0.36])):
        draw(canvas, directions * 0.03 + np.array(centre), faces, intrinsics=K, instance=instance)
    return 1 / canvas.inverse_depth, canvas.ids


def test_depth_of_a_sphere_is_that_of_the_ray_that_hits_it() -> None:
    depth, ids = _scene(whole_image(K))
    v, u = np.nonzero(ids == 2)
    ray = np.stack([(u - K.cx) / K.fx, (v - K.cy) / K.fy, np.ones(len(u))], axis=1)
    centre, radius = np.array([0.05, 0.01, 0.36]), 0.03
    a, b, c = (ray**2).sum(1), ray @ centre, centre @ centre - radius**2
    hit = b * b - a * c > 0
    exact = (b[hit] - np.sqrt(b[hit] ** 2 - a[hit] * c)) / a[hit]
    assert hit.mean() > 0.99
    inner = np.abs(depth[v, u][hit] - exact)
    assert np.median(inner) < 5e-5  # facets of a 3 mm mesh
    assert np.quantile(inner, 0.95) < 5e-4


def test_the_nearer_body_is_seen_and_the_wall_stays() -> None:
    depth, ids = _scene(whole_image(K))
    assert set(np.unique(ids)) == {0, 1, 2}
    np.testing.assert_allclose(depth[ids == 0], 0.5, rtol=1e-6)
    assert depth[ids > 0].max() < 0.5
    both = ids[round(K.cy + K.fy * 0.01 / 0.39), round(K.cx + K.fx * 0.035 / 0.36)]
    assert both == 2


def test_a_crop_is_cut_from_the_whole_image() -> None:
    depth, ids = _scene(whole_image(K))
    window = Window(440, 230, 60, 90)
    crop_depth, crop_ids = _scene(window)
    part = (slice(window.v0, window.v0 + window.height), slice(window.u0, window.u0 + window.width))
    assert np.array_equal(crop_ids, ids[part])
    np.testing.assert_allclose(crop_depth, depth[part], rtol=1e-6)


def test_bodies_beside_or_behind_the_camera_draw_nothing() -> None:
    directions, faces = icosphere(2)
    canvas = canvas_over(np.full((K.height, K.width), 0.5, np.float32), whole_image(K))
    for centre in ([2.0, 0, 0.4], [0, -2.0, 0.4], [0, 0, -0.4]):
        draw(canvas, directions * 0.03 + np.array(centre), faces, intrinsics=K, instance=1)
    assert not canvas.ids.any()
