"""Whole scenes: geometry, truth, repeatability."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from camera_sim.sim.faults import check_faults
from camera_sim.sim.optics import BASELINE_M
from camera_sim.sim.record import record_scene
from camera_sim.sim.scenes import SCENES, SceneSettings, build_world, layout_named
from camera_sim.sim.source import simulated_sources, truth_of
from camera_sim.sim.world import crossing_travel_m, mount, render
from conveyor.errors import InputError
from conveyor.geometry import belt_distance_m, straight_down_belt_from_camera, transform_points


def _world(settings: SceneSettings, scene: str) -> tuple:
    settings = replace(settings, scene=scene)
    layout = layout_named(scene)
    world = build_world(settings, layout)
    return settings, world, simulated_sources(world, settings, layout, masks=True)


def test_a_mounted_camera_looks_at_its_point_from_its_distance() -> None:
    np.testing.assert_allclose(mount(0.46), straight_down_belt_from_camera(0.46), atol=1e-12)
    tilted = mount(0.46, x_m=0.1, y_m=-0.2, tilt_deg=(4.0, -3.0))
    assert belt_distance_m(tilted) == pytest.approx(0.46)
    looked_at = transform_points(tilted, np.array([[0.0, 0.0, 0.46]]))
    np.testing.assert_allclose(looked_at, [[0.1, -0.2, 0.0]], atol=1e-12)


@pytest.mark.parametrize("scene", ["touching", "tilted", "two-cameras"])
def test_truth_is_where_the_picture_says(scene: str, small_settings: SceneSettings) -> None:
    """At the travel of its crossing a tuber's visible mask is centred on the centre row, but for its lean."""
    settings, world, sources = _world(small_settings, scene)
    checked = 0
    for camera in world.cameras:
        k = camera.optics.intrinsics
        for body in world.bodies:
            travel = crossing_travel_m(body, camera)
            if travel is None:
                continue
            ids = render(world, camera, travel).ids
            v, u = np.nonzero(ids == body.body_id)
            half_mm = np.ptp(body.vertices, axis=0).max() / 2
            lean_px = 0.3 * half_mm / settings.belt_distance_m * k.fy
            assert abs(v.mean() - k.cy) < lean_px + 1, (body.body_id, camera.name)
            assert k.fx * BASELINE_M / settings.belt_distance_m < u.mean() + lean_px
            checked += 1
    assert checked >= settings.tubers
    truth = truth_of(world, sources)
    assert len(truth["tubers"]) == settings.tubers
    for row in truth["tubers"]:
        place = world.bodies[row["id"] - 1].place
        assert (row["place_x_m"], row["place_y_m"]) == pytest.approx(tuple(place[:2]), abs=1e-5)


def test_belt_coordinates_hold_for_every_camera(small_settings: SceneSettings) -> None:
    """A tuber's visible points, taken to belt coordinates by each camera's own matrix, lie at one place."""
    _, world, sources = _world(small_settings, "two-cameras")
    both = [row for row in truth_of(world, sources)["tubers"] if len(row["cameras"]) == 2]
    assert both
    for row in both:
        places = []
        for camera in world.cameras:
            body = world.bodies[row["id"] - 1]
            travel = crossing_travel_m(body, camera)
            canvas = render(world, camera, travel)
            v, u = np.nonzero(canvas.ids == body.body_id)
            z = 1 / canvas.inverse_depth[v, u].astype(float)
            k = camera.optics.intrinsics
            points = np.stack([(u - k.cx) / k.fx * z, (v - k.cy) / k.fy * z, z], axis=1)
            belt = transform_points(camera.belt_from_camera, points)
            low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
            shift = np.array([travel, 0, 0])
            assert (belt > low + shift - 0.003).all()
            assert (belt < high + shift + 0.003).all()
            places.append(belt.mean(axis=0)[:2] - [travel, 0])
        assert np.linalg.norm(places[0] - places[1]) < 0.03


def test_frame_n_is_the_same_whatever_came_before(small_settings: SceneSettings) -> None:
    _, _, first = _world(small_settings, "touching")
    _, _, second = _world(small_settings, "touching")
    frames = list(first[0].frames(run="a"))
    again = second[0].frame(7, run="a")
    assert np.array_equal(frames[7].depth, again.depth)
    assert np.array_equal(frames[7].mask, again.mask)
    assert frames[7].captured_ns == again.captured_ns
    assert not np.array_equal(frames[7].depth, frames[8].depth)


def test_a_seed_gives_the_same_files(small_settings: SceneSettings, tmp_path: Path) -> None:
    settings = replace(small_settings, tubers=2)
    for name in ("a", "b"):
        record_scene(tmp_path / name, settings)
    record_scene(tmp_path / "c", replace(settings, seed=4))
    hashes = {}
    for name in ("a", "b", "c"):
        files = sorted(p for p in (tmp_path / name).rglob("*") if p.is_file())
        hashes[name] = [
            (str(p.relative_to(tmp_path / name)), hashlib.sha256(p.read_bytes()).hexdigest()) for p in files
        ]
    assert hashes["a"] == hashes["b"]
    assert hashes["a"] != hashes["c"]


def test_dropped_frames_are_gaps_and_tubers_stay(small_settings: SceneSettings) -> None:
    _, world, sources = _world(small_settings, "dropped-frames")
    numbers = [frame.seq for frame in sources[0].frames(run="a")]
    missing = 1 - len(numbers) / (numbers[-1] + 1)
    assert numbers[0] == 0
    assert 0.10 < missing < 0.25
    assert len(numbers) == sources[0].description.frames
    assert len(truth_of(world, sources)["tubers"]) == small_settings.tubers


def test_the_belt_stops_and_goes(small_settings: SceneSettings) -> None:
    settings, world, sources = _world(replace(small_settings, tubers=20, fps=5.0), "stop-and-go")
    count = sources[0].description.frames
    travel = np.array([world.motion.travel_at(sources[0].time_s(seq)) for seq in range(count)])
    steps = np.diff(travel)
    assert (steps >= 0).all()
    assert (steps == 0).any()
    assert steps.max() == pytest.approx(settings.speed_mps / settings.fps, rel=0.05)


def test_distractors_are_seen_but_not_in_masks_or_truth(small_settings: SceneSettings) -> None:
    settings, world, sources = _world(small_settings, "distractors")
    truth = truth_of(world, sources)
    assert truth["distractors"] == len(world.bodies) - settings.tubers > 0
    assert sum(truth["distractor_kinds"].values()) == truth["distractors"]
    labels = {int(n) for frame in sources[0].frames(run="a") for n in np.unique(frame.mask)}
    assert labels <= set(range(settings.tubers + 1))
    assert len(labels) == settings.tubers + 1


def test_believed_belt_distance_differs_in_the_field_preset_only_by_millimetres(small_settings: SceneSettings) -> None:
    from camera_sim.sim.presets import FIELD_PRESET

    errors = []
    for seed in range(12):
        _, world, _ = _world(replace(small_settings, preset=FIELD_PRESET, seed=seed, tubers=1), "singulated")
        camera = world.cameras[0]
        errors.append(belt_distance_m(camera.believed_belt_from_camera) - belt_distance_m(camera.belt_from_camera))
    assert 0.0005 < np.std(errors) < 0.004


def test_unknown_scenes_are_refused_with_the_known_ones(small_settings: SceneSettings) -> None:
    with pytest.raises(InputError, match=r"scene 'heap' is unknown; known: singulated, .*tilted"):
        layout_named("heap")
    assert set(SCENES) >= {"singulated", "touching", "crowded", "distractors", "two-cameras", "two-lane"}


def test_truth_file_has_the_keys_of_the_format(small_recording: Path) -> None:
    truth = json.loads((small_recording / "truth.json").read_text())
    assert truth["distractors"] == 0
    needed = {"id", "weight_g", "length_mm", "width_mm", "height_mm", "place_x_m", "place_y_m", "cameras"}
    assert needed <= set(truth["tubers"][0])


def test_faults_are_injected_by_name(small_settings: SceneSettings) -> None:
    settings = replace(small_settings, tubers=12)
    layout = layout_named("touching")
    world = build_world(settings, layout)
    plain = list(simulated_sources(world, settings, layout)[0].frames(run="a"))

    def faulty(name: str) -> list:
        return list(simulated_sources(world, settings, layout, faults=(name,))[0].frames(run="a"))

    assert len(plain) - len(faulty("dropped")) >= 0.1 * len(plain)
    twice = [
        (a, b) for a, b in pairwise(faulty("duplicated")) if a.captured_ns == b.captured_ns and a.travel_m == b.travel_m
    ]
    assert twice
    assert all(np.array_equal(a.depth, b.depth) and b.seq == a.seq + 1 for a, b in twice)
    still = [(a, b) for a, b in pairwise(faulty("frozen")) if np.array_equal(a.depth, b.depth)]
    assert len(still) == int(0.7 * settings.fps)
    assert all(b.captured_ns > a.captured_ns and b.travel_m > a.travel_m for a, b in still)
    jumps = np.diff([frame.captured_ns for frame in faulty("clock-jump")]) / 1e9
    assert sorted(np.round(jumps[np.abs(jumps) > 1]).astype(int)) == [-45, 45]
    with pytest.raises(InputError, match="--inject fire is unknown; known: dropped, duplicated, frozen, clock-jump"):
        check_faults(("fire",))
