"""The other world (`benchmarks/otherworld*`): its bodies, frames and truth are what they say they are."""

from __future__ import annotations

import ast
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.otherworld_camera import Camera, Sensor, View
from benchmarks.otherworld_scenes import Scene, lay, support, write
from benchmarks.otherworld_shapes import FAMILIES, at_rest, mass_centre, sphere, tuber
from benchmarks.otherworld_table import SCENES

FOLDER = Path(__file__).parents[2] / "benchmarks"


def test_it_shares_nothing_with_the_simulator_that_tuberline_was_tuned_on() -> None:
    for path in FOLDER.glob("otherworld*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not any(name.split(".")[0] == "camera_sim" for name in names), path.name


def test_the_volume_is_that_of_the_mesh_and_an_ellipsoid_rests_on_its_flat_side() -> None:
    unit, triangles = sphere()
    points = unit * np.array([0.04, 0.03, 0.02])
    assert mass_centre(points, triangles)[0] == pytest.approx(4 / 3 * np.pi * 0.04 * 0.03 * 0.02, rel=0.01)
    for seed in range(4):
        body = at_rest(points, triangles, np.random.default_rng(seed), g_per_ml=1.07, kind="smooth")
        assert body.vertices_m[:, 2].min() == 0.0
        assert body.vertices_m[:, 2].max() == pytest.approx(0.04, abs=0.001)


@pytest.mark.parametrize("family", FAMILIES)
def test_tubers_weigh_what_their_volume_and_a_measured_density_say(family: str) -> None:
    body = tuber(np.random.default_rng(3), family)
    volume, centre = mass_centre(body.vertices_m, body.triangles)
    assert volume * 1e6 == pytest.approx(body.volume_ml)
    assert 1.02 <= body.weight_g / body.volume_ml <= 1.12
    np.testing.assert_allclose(centre[:2], 0.0, atol=1e-4)


def test_no_two_bodies_of_a_belt_overlap() -> None:
    """Only the last thirty were kept apart from a new one, and the front of a longer belt lay in itself."""
    scene = Scene("crowded", 5, (), Sensor(), "crowded", tubers=45)
    lying = lay(scene, np.random.default_rng(5))
    half = np.array([support(one.body)[:24] + support(one.body)[24:] for one in lying]).min(1) / 2
    for i, one in enumerate(lying):
        for j, other in enumerate(lying[:i]):
            assert np.hypot(one.x_m - other.x_m, one.y_m - other.y_m) >= half[i] + half[j] - 0.012


def test_a_tilted_camera_sees_the_belt_where_its_matrix_says() -> None:
    camera = Camera("cam", 64, 48, 40.0, 0.5, 0.1, -0.2, pitch_deg=7, roll_deg=-4)
    depth, _ = View(camera, Sensor(), np.random.default_rng(0)).exact([])
    cx, cy = camera.centre_px
    v, u = np.mgrid[:48, :64]
    points = np.stack([(u - cx) / 40 * depth, (v - cy) / 40 * depth, depth, np.ones_like(depth)], -1)
    np.testing.assert_allclose((points @ camera.belt_from_camera.T)[..., 2], 0.0, atol=1e-9)
    assert depth[round(cy), round(cx)] == pytest.approx(camera.belt_distance_m, rel=0.01)


def test_a_recording_has_each_frame_and_the_truth_of_those_that_cross(tmp_path: Path) -> None:
    camera = Camera("cam", 160, 120, 110.0, 0.4)
    write(Scene("s", 1, (camera,), Sensor(), "singulated", tubers=3, lane_m=0.2, fps=5), tmp_path)
    truth = json.loads((tmp_path / "truth.json").read_text(encoding="utf-8"))
    frames = sorted((tmp_path / "cam/depth").iterdir())
    assert len(truth["tubers"]) == 3
    assert len((tmp_path / "cam/frames.csv").read_text().splitlines()) == len(frames) + 1
    first, middle = (cv2.imread(str(frames[i]), cv2.IMREAD_UNCHANGED) for i in (0, len(frames) // 2))
    assert set(np.unique(first)) == {400}  # bare belt
    assert middle.min() < 380


def test_the_table_has_its_seeds_once() -> None:
    assert len({scene.seed for scene in SCENES}) == len(SCENES) >= 24
