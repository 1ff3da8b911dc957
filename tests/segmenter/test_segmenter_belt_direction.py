"""Which way the belt runs through the image, by the load alone."""

from __future__ import annotations

import numpy as np
import pytest
from segmenter_scene import SMALL, Scene, scattered, tilted

from conveyor.camera_place import CameraPlace
from conveyor.geometry import straight_down_belt_from_camera
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.belt_direction import BeltDirection, common_move
from segmenter.frame.heights import height_map
from segmenter.perception import Perception
from segmenter.pipeline import Settings

STEP_M = 0.0133


def heading(scene: Scene, frames: int = 40) -> BeltDirection:
    """As a camera of which nothing but its distance is known sees it."""
    settings, direction = Settings(), BeltDirection()
    perception = Perception(settings.perception, settings.split)
    belt = BeltGeometry(SMALL, straight_down_belt_from_camera(0.46))
    for seq in range(frames):
        frame = scene.frame(seq, seq * STEP_M)
        heights = height_map(frame.depth, depth_scale_m=0.001, belt=belt, pixel_mm=settings.split.pixel_mm)
        found = perception.find(heights, belt)
        whole = ~found.cut.any(axis=1)
        direction.step(found.centre_m[whole], found.area_m2[whole])
    return direction


@pytest.mark.parametrize("turned_deg", [0.0, 7.3, -90.0, 175.0])
def test_the_turn_of_a_camera_is_found(turned_deg: float) -> None:
    pose = CameraPlace(turned_deg=turned_deg).straight_down(0.46)
    direction = heading(Scene(scattered(30, seed=5), SMALL, pose, noise_m=0.001))
    assert direction.known
    off_deg = (direction.heading_deg + turned_deg + 180) % 360 - 180
    assert abs(off_deg) < max(0.5, 3 * direction.heading_sd_deg)
    assert direction.heading_sd_deg < 0.5
    assert direction.travelled_m == pytest.approx(len(direction.moves_m) * STEP_M, rel=0.03)


def test_a_belt_that_stands_or_is_bare_says_nothing() -> None:
    still = BeltDirection()
    places = np.array([[0.0, 0.0], [0.05, 0.02]])
    for _ in range(20):
        still.step(places, np.array([0.002, 0.003]))
    bare = BeltDirection()
    for _ in range(20):
        bare.step(np.zeros((0, 2)), np.zeros(0))
    assert (still.moves_m, bare.moves_m) == ([], [])
    assert not still.known
    assert not bare.known


def test_most_say_the_move_and_one_that_came_or_went_does_not_matter() -> None:
    rng = np.random.default_rng(4)
    before, area = rng.uniform(-0.2, 0.2, (9, 2)), rng.uniform(0.001, 0.004, 9)
    move = np.array([0.031, -0.012])
    after = np.vstack([before[1:] + move, [[0.19, 0.19]]])
    found = common_move(before, area, after, np.append(area[1:], 0.002))
    np.testing.assert_allclose(found, move, atol=1e-9)
    lone = common_move(before[:1], area[:1], before[:1] + move, area[:1])
    np.testing.assert_allclose(lone, move)
    assert common_move(before, area, before + 0.5, area) is None


def test_of_two_in_view_one_alone_says_no_move() -> None:
    """One that left and one of its size that came were one move: a camera was taken to be turned by five degrees."""
    direction = BeltDirection()
    direction.step(np.array([[0.0, 0.0], [0.1, 0.1]]), np.array([0.002, 0.006]))
    direction.step(np.array([[0.03, 0.05], [-0.1, -0.1]]), np.array([0.002, 0.001]))
    assert direction.moves_m == []


def test_a_leaning_camera_is_no_turned_one() -> None:
    pose = tilted(0.46, 3.0)
    direction = heading(Scene(scattered(30, seed=6), SMALL, pose, noise_m=0.001))
    assert abs(direction.heading_deg) < 1.0
