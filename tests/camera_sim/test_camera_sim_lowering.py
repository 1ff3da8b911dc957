"""Where bodies lie on rods, cleats and sagging belts, and what a camera sees of the rods."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from camera_sim.sim.belt import belt_depth
from camera_sim.sim.lowering import Support, rest_height_m, settled, typical_sink_m, underside_of
from camera_sim.sim.meshes import Vertices, icosphere
from camera_sim.sim.poses import free_rotation, rest_on_belt
from camera_sim.sim.rods import Rods
from camera_sim.sim.scenes import SceneSettings, build_world, in_its_world, layout_named
from camera_sim.sim.surface import SAG_SPAN_M, Surface
from camera_sim.sim.tubers import draw_tuber
from camera_sim.sim.world import World, render
from conveyor.geometry import Intrinsics, straight_down_belt_from_camera

WEBS = [Rods(0.0055, 0.040), Rods(0.00525, 0.028), Rods(0.006, 0.036), Rods(0.006, 0.050)]


def _support(rods: Rods) -> Support:
    support = Surface("rods", rods=rods).support
    assert support is not None
    return support


def _sphere(radius_m: float) -> tuple[Vertices, np.ndarray]:
    directions, faces = icosphere(4)
    return directions * radius_m + np.array([0.0, 0.0, radius_m]), faces


def _sphere_sink_m(rods: Rods, radius_m: float) -> float:
    """Of the underside of a sphere below the tops of two rods that it lies between."""
    reach_m = radius_m + rods.radius_m
    return reach_m - float(np.sqrt(reach_m**2 - (rods.pitch_m / 2) ** 2))


HELD = [(rods, radius_mm) for rods in WEBS for radius_mm in (20, 28, 40) if 2 * radius_mm > 1000 * rods.gap_m + 4]


@pytest.mark.parametrize(("rods", "radius_mm"), HELD)
def test_a_sphere_sinks_between_rods_as_geometry_says(rods: Rods, radius_mm: int, rng: np.random.Generator) -> None:
    """From wherever it is put down."""
    points, faces = _sphere(radius_mm / 1000)
    for start_m in rng.uniform(-0.1, 0.1, 5).tolist():
        x_m, z_m = settled(underside_of(points, faces), _support(rods), start_m)
        assert -z_m == pytest.approx(_sphere_sink_m(rods, radius_mm / 1000), abs=0.0003)
        assert abs(x_m / rods.pitch_m - round(x_m / rods.pitch_m)) * rods.pitch_m < 0.0005  # midway between centres
        assert abs(x_m - start_m) <= rods.pitch_m / 2 + 0.001


def test_figures_of_the_sphere_on_an_ordinary_web() -> None:
    rods = Rods(0.0055, 0.040)
    sinks_mm = [1000 * _sphere_sink_m(rods, radius) for radius in (0.020, 0.028, 0.040)]
    assert sinks_mm == pytest.approx([9.7, 6.6, 4.6], abs=0.05)


def test_a_sphere_on_top_of_a_rod_does_not_sink() -> None:
    rods = WEBS[0]
    points, faces = _sphere(0.028)
    assert rest_height_m(underside_of(points, faces), _support(rods), rods.pitch_m / 2) == pytest.approx(0, abs=2e-4)


@pytest.mark.parametrize("rods", WEBS[:3])
def test_a_tuber_touches_the_rods_and_goes_into_none(rods: Rods, rng: np.random.Generator) -> None:
    for _ in range(8):
        tuber = draw_tuber(rng)
        while tuber.axes_mm[1] < 1000 * rods.gap_m:
            tuber = draw_tuber(rng)
        body = rest_on_belt(tuber.vertices, free_rotation(rng))
        x_m, z_m = settled(underside_of(body, tuber.faces), _support(rods), float(rng.uniform(0, 1)))
        if -z_m > 0.44 * np.ptp(body[:, 2]):
            continue  # it hangs as deep as it may
        x, z = body[:, 0] + x_m, body[:, 2] + z_m
        centre = (np.floor(x / rods.pitch_m) + 0.5) * rods.pitch_m
        outside = np.hypot(x - centre, z + rods.radius_m) - rods.radius_m
        assert -0.0002 < outside.min() < 0.0006  # vertices are 2 mm apart
        assert z_m <= 1e-6


def test_a_body_between_cleats_lies_on_the_belt_and_over_one_it_is_held_up() -> None:
    support = Surface("cleats", cleat_m=0.008, cleat_pitch_mm=128).support
    assert support is not None
    points, faces = _sphere(0.025)
    underside = underside_of(points, faces)
    assert rest_height_m(underside, support, 0.070) == pytest.approx(0.0, abs=1e-4)
    assert rest_height_m(underside, support, 0.006) == pytest.approx(0.008, abs=3e-4)
    assert settled(underside, support, 0.012)[1] < 0.0005
    assert typical_sink_m(support) <= 0.0


def test_backwards_it_settles_behind_where_it_was_put(rng: np.random.Generator) -> None:
    points, faces = _sphere(0.028)
    rods = WEBS[0]
    for start_m in rng.uniform(-0.1, 0.1, 10).tolist():
        x_m, z_m = settled(underside_of(points, faces), _support(rods), start_m, backwards=True)
        assert start_m - rods.pitch_m - 0.001 <= x_m <= start_m
        assert z_m <= rest_height_m(underside_of(points, faces), _support(rods), start_m) + 1e-9


def test_rods_are_seen_with_their_flanks() -> None:
    """Beside the optical axis a ray meets a rod where a circle of its radius is, and the ground between."""
    rods, distance_m = Rods(0.006, 0.040, below_m=0.05), 0.46
    belt = Surface("rods", rods=rods).belt(np.random.default_rng(1), soil_m=0.0)
    k = Intrinsics(21, 721, 653.8, 653.8, 10.0, 360.0)
    camera = straight_down_belt_from_camera(distance_m)
    depth = belt_depth(
        belt, intrinsics=k, belt_from_camera=camera, travel_m=0.0, u0=0, v0=0, height=k.height, width=k.width
    )[:, 10].astype(float)
    x_m, z_m = (np.arange(721) - k.cy) / k.fy * depth, distance_m - depth
    to_rod = np.hypot((x_m / rods.pitch_m) % 1 * rods.pitch_m - rods.pitch_m / 2, z_m + rods.radius_m)
    on_rod = np.abs(to_rod - rods.radius_m) < 1e-5
    on_ground = np.abs(z_m + rods.below_m) < 1e-5
    assert (on_rod | on_ground).all()
    assert z_m[on_rod].max() == pytest.approx(0.0, abs=2e-5)
    outer = on_rod & (np.abs(x_m) > 0.15)
    assert z_m[outer].min() < -rods.radius_m  # below the widest point: only the near flank of a rod shows that
    assert 0.3 < on_rod.mean() < 0.5


def _world(settings: SceneSettings, scene: str) -> tuple[World, SceneSettings]:
    layout = layout_named(scene)
    settings = in_its_world(replace(settings, scene=scene), layout)
    return build_world(settings, layout), settings


def test_the_load_of_the_scene_rods_lies_between_them(small_settings: SceneSettings) -> None:
    world, settings = _world(replace(small_settings, tubers=20), "rods")
    lowest_mm = np.array([1000 * body.vertices[:, 2].min() for body in world.bodies])
    assert (lowest_mm < 0.01).all()
    assert np.median(-lowest_mm) == pytest.approx(1000 * settings.resting_m(layout_named("rods")), abs=1.5)
    assert settings.stated is not None
    assert settings.stated.offset_m == settings.resting_m(layout_named("rods")) > 0.002


def test_a_constant_resting_offset_lowers_all_and_changes_nothing_else(small_settings: SceneSettings) -> None:
    plain, _ = _world(small_settings, "touching")
    sunk, settings = _world(replace(small_settings, resting_offset_mm=5.5), "touching")
    for one, other in zip(plain.bodies, sunk.bodies, strict=True):
        np.testing.assert_allclose(one.vertices - other.vertices, [[0, 0, 0.0055]] * len(one.vertices), atol=1e-12)
    assert settings.stated is not None
    assert settings.stated.offset_m == pytest.approx(0.0055)
    assert np.array_equal(plain.belt.relief_m, sunk.belt.relief_m)


def test_a_sagging_belt_and_its_load_sag_together() -> None:
    surface = Surface("sagging", sag_m=0.008)
    relief = surface.belt(np.random.default_rng(1), soil_m=0.0).relief_m
    y_m = np.array([0.0, 0.1, -0.1, SAG_SPAN_M / 2])
    columns = np.floor(y_m * 1000).astype(int) & 1023
    np.testing.assert_allclose(relief[500, columns], surface.height_m(y_m), atol=3e-5)
    assert surface.height_m(SAG_SPAN_M / 2) - surface.height_m(0.0) == pytest.approx(0.008)
    assert surface.height_m(np.linspace(-0.25, 0.25, 1001)).mean() == pytest.approx(0.0, abs=1e-5)


def test_heave_moves_belt_and_load_under_the_camera(small_settings: SceneSettings) -> None:
    world, _ = _world(replace(small_settings, heave_mm=3.0, heave_hz=4.0), "touching")
    camera = world.cameras[0]
    level, high = (1 / render(world, camera, -1.0, time_s=time_s).inverse_depth for time_s in (0.0, 1 / 16))
    assert np.median(level - high) == pytest.approx(0.003, abs=2e-4)
