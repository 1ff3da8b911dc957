"""Simulated tubers against the real ones' numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from camera_sim.sim.cultivars import Relief, draw_recipe
from camera_sim.sim.distractors import LUMP_RMS, clod, draw_hard_negative, lump
from camera_sim.sim.meshes import icosphere, random_rotation, rotation_about, rotation_taking, volume
from camera_sim.sim.poses import rest_on_belt, resting_rotation
from camera_sim.sim.tubers import draw_tuber, grow


def test_a_sphere_has_its_volume_and_its_rotation_too() -> None:
    directions, faces = icosphere(4)
    assert len(directions) == 2562
    assert len(faces) == 5120
    turned = directions @ random_rotation(np.random.default_rng(1)).T + 3.0
    assert volume(directions, faces) == pytest.approx(4 / 3 * np.pi, rel=3e-3)
    assert volume(turned, faces) == pytest.approx(volume(directions, faces), rel=1e-9)


def test_rotations_are_rotations(rng: np.random.Generator) -> None:
    for _ in range(20):
        a, b = rng.standard_normal((2, 3))
        a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
        for r in (random_rotation(rng), rotation_about(a, rng.uniform(-3, 3)), rotation_taking(a, b)):
            np.testing.assert_allclose(r @ r.T, np.eye(3), atol=1e-12)
            assert np.linalg.det(r) == pytest.approx(1)
        np.testing.assert_allclose(rotation_taking(a, b) @ a, b, atol=1e-12)
        np.testing.assert_allclose(rotation_taking(a, -a) @ a, -a, atol=1e-9)


def test_weights_follow_the_859_real_tubers() -> None:
    """Real: mean 172.2, sd 109.2, quartiles 88, 150, 243 g."""
    rng = np.random.default_rng(0)
    recipes = [draw_recipe(rng) for _ in range(4000)]
    weights = np.array([r.volume_ml * r.density_g_ml for r in recipes])
    assert weights.min() >= 16
    assert weights.max() <= 624
    assert weights.mean() == pytest.approx(172.2, abs=10)
    assert weights.std() == pytest.approx(109.2, abs=8)
    assert np.quantile(weights, 0.5) == pytest.approx(150, abs=15)
    sayaka = weights[[r.stock.cultivar == "Sayaka" for r in recipes]]
    assert sayaka.mean() == pytest.approx(167.4, abs=8)


def test_weight_is_the_meshs_volume_times_a_tubers_density() -> None:
    tubers = [draw_tuber(np.random.default_rng([1, i]), level=3) for i in range(150)]
    for tuber in tubers:
        assert tuber.volume_ml == pytest.approx(volume(tuber.vertices, tuber.faces) * 1e6, rel=1e-9)
        assert 1.0 < tuber.weight_g / tuber.volume_ml < 1.14
        box_mm = np.ptp(tuber.vertices, axis=0) * 1000
        np.testing.assert_allclose(box_mm, tuber.axes_mm, rtol=1e-9)
        assert tuber.axes_mm[0] >= tuber.axes_mm[1] >= tuber.axes_mm[2]
    fullness = [t.volume_ml / (np.pi / 6 * np.prod(t.axes_mm) / 1000) for t in tubers if t.stock.season == "2023"]
    assert np.mean(fullness) == pytest.approx(1.108, abs=0.03)  # tubers are fuller than ellipsoids


def test_second_growth_makes_some_of_2025_concave() -> None:
    """Real convexity in 2025: 5 % below .79, a quarter below .92; in 2023 hardly any below .96."""
    hollow = {"2023": [], "2025": []}
    for i in range(220):
        tuber = draw_tuber(np.random.default_rng([2, i]), level=3)
        if tuber.stock.season in hollow:
            hollow[tuber.stock.season].append(tuber.volume_ml * 1e-6 / ConvexHull(tuber.vertices).volume)
    assert np.quantile(hollow["2025"], 0.05) < 0.92
    assert np.quantile(hollow["2023"], 0.05) > 0.95


def test_a_bumpy_tuber_is_as_hollow_as_real_ones_and_keeps_its_volume() -> None:
    """Real convexity: Sayaka .986, 2025 .939. Ordinary simulated tubers of 2023 have .995."""
    hollow = []
    for i in range(40):
        recipe = replace(draw_recipe(np.random.default_rng([3, i])), knobs=0.0, relief=Relief(0.08, finest=9, fall=1.0))
        tuber = grow(recipe, np.random.default_rng([4, i]), level=3)
        assert tuber.volume_ml == pytest.approx(recipe.volume_ml, rel=1e-6)
        hollow.append(tuber.volume_ml * 1e-6 / ConvexHull(tuber.vertices).volume)
    assert 0.93 < np.median(hollow) < 0.985


def test_a_resting_tuber_lies_low_and_on_the_belt(rng: np.random.Generator) -> None:
    for i in range(10):
        tuber = draw_tuber(np.random.default_rng([3, i]), level=3)
        points = rest_on_belt(tuber.vertices, resting_rotation(tuber.vertices, rng))
        assert points[:, 2].min() == pytest.approx(0, abs=1e-12)
        assert points[:, 2].max() * 1000 < (tuber.axes_mm[1] + tuber.axes_mm[0]) / 2 + 3


def test_the_same_seed_gives_the_same_tuber() -> None:
    one, two = (draw_tuber(np.random.default_rng(5)) for _ in range(2))
    assert np.array_equal(one.vertices, two.vertices)
    assert one.weight_g == two.weight_g


def test_lumps_have_no_fine_relief_and_more_of_the_coarse_than_tubers(rng: np.random.Generator) -> None:
    _, faces = icosphere(3)
    edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)

    def roughness(vertices: np.ndarray) -> float:
        """Change of the radius along an edge, as a share of it: the mesh's finest detail."""
        radius = np.linalg.norm(vertices / np.abs(vertices).max(axis=0), axis=1)
        return float(np.std(np.diff(radius[edges], axis=1)))

    lumps, clods = (np.array([roughness(draw(rng)[0]) for _ in range(30)]) for draw in (lump, clod))
    assert np.median(lumps) < 0.75 * np.median(clods)
    tubers = np.array([roughness(draw_tuber(rng, level=3).vertices) for _ in range(30)])
    assert np.median(lumps) > 1.3 * np.median(tubers)
    assert LUMP_RMS[0] > 2 * 0.022  # twice a tuber's


def test_hard_negatives_are_clods_and_stones_of_a_tubers_size(rng: np.random.Generator) -> None:
    drawn = [draw_hard_negative(rng) for _ in range(300)]
    kinds = [kind for kind, _ in drawn]
    assert min(kinds.count("clod"), kinds.count("stone")) > 3 * kinds.count("haulm")
    sizes = [np.ptp(vertices, axis=0).max() for kind, (vertices, _) in drawn if kind != "haulm"]
    assert 0.015 < min(sizes) < np.median(sizes) < max(sizes) < 0.14
