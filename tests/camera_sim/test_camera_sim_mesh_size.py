"""The square-mesh size: of bodies whose answer is known, in any position, and of tubers without their soil."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from camera_sim.sim.mesh_size import square_mesh_m
from camera_sim.sim.meshes import icosphere, random_rotation
from camera_sim.sim.tubers import draw_tuber, with_jacket

SEED = 20261122


@pytest.mark.parametrize("axes", [(90, 60, 50), (80, 60, 40), (60, 60, 60), (110, 45, 30)])
def test_an_ellipsoid_passes_turned_by_45_degrees(axes: tuple[int, int, int]) -> None:
    body = icosphere(4)[0] * np.array(axes) / 2
    expected = np.hypot(axes[1], axes[2]) / np.sqrt(2)
    assert square_mesh_m(body) == pytest.approx(expected, rel=2e-3)


def test_a_box_passes_as_its_smaller_face_lies_or_turned() -> None:
    """A square turned in a square hole needs more room, a flat box as much as its wider side at most."""
    for sides, expected in (((50, 30, 30), 30.0), ((50, 40, 30), 40.0), ((90, 40, 4), 44 / np.sqrt(2))):
        box = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * sides
        assert square_mesh_m(box) == pytest.approx(expected, abs=0.02)


def test_it_is_the_same_however_the_body_lies() -> None:
    rng = np.random.default_rng(SEED)
    for _ in range(4):
        tuber = draw_tuber(rng, level=3)
        sizes = [1000 * square_mesh_m(tuber.vertices @ random_rotation(rng).T) for _ in range(3)]
        assert np.ptp(sizes) < 0.15, f"seed {SEED}: {sizes}"


def test_soil_is_no_part_of_a_tubers_size() -> None:
    rng = np.random.default_rng(SEED)
    tuber = draw_tuber(rng, level=3)
    soiled = with_jacket(tuber, rng, mean_m=0.0015)
    assert soiled.square_mesh_mm == tuber.square_mesh_mm
    assert 1000 * square_mesh_m(soiled.vertices) > tuber.square_mesh_mm + 1
    width, thickness = tuber.axes_mm[1:]
    assert thickness < tuber.square_mesh_mm < 1.15 * np.hypot(width, thickness) / np.sqrt(2)
