"""Instances and their places against analytic truth, at every resolution, unit and belt distance."""

from __future__ import annotations

import numpy as np
import pytest
from segmenter_scene import MEDIUM, SMALL, Body, Scene, scattered, tilted

from conveyor.geometry import Intrinsics, straight_down_belt_from_camera
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.heights import height_map
from segmenter.frame.instances import Instances, SplitSettings, full_resolution, given, split
from segmenter.studies.evaluate import agreement

WIDE = Intrinsics(1280, 720, 653.763, 652.116, 643.484, 366.065)
ODD = Intrinsics(643, 481, 600.0, 590.0, 330.0, 236.0)


def segment(scene: Scene, travel_m: float = 0.2) -> tuple[Instances, np.ndarray, np.ndarray]:
    depth, labels = scene.render(travel_m)
    belt = BeltGeometry(scene.intrinsics, scene.belt_from_camera)
    heights = height_map(depth, depth_scale_m=scene.scale_m, belt=belt, pixel_mm=1.45)
    return split(heights, belt, SplitSettings()), depth, labels


@pytest.mark.parametrize("intrinsics", [SMALL, MEDIUM, WIDE, ODD], ids=lambda k: f"{k.width}x{k.height}")
@pytest.mark.parametrize("distance_m", [0.345, 0.46])
@pytest.mark.parametrize("scale_m", [0.001, 0.0001])
def test_centres_sizes_and_volumes_agree_with_truth(intrinsics: Intrinsics, distance_m: float, scale_m: float) -> None:
    pose = straight_down_belt_from_camera(distance_m)
    bodies = scattered(12, seed=7)
    scene = Scene(bodies, intrinsics, pose, scale_m, noise_m=0.001, holes=0.03)
    found, _, _ = segment(scene)
    checked = 0
    for body in bodies:
        gap = found.centre_m - [body.place_x_m + 0.2, body.y_m]
        nearest = int(np.argmin(np.hypot(*gap.T)))
        if np.hypot(*gap[nearest]) > 0.03 or found.cut[nearest].any():
            continue
        checked += 1
        assert np.hypot(*gap[nearest]) < 0.0015
        assert found.height_m[nearest] == pytest.approx(2 * body.c_m, abs=0.0025)
        assert found.volume_m3[nearest] == pytest.approx(body.volume_under_m3, rel=0.12)
    assert checked >= 3


def test_a_tilted_camera_sees_the_same_places() -> None:
    bodies = scattered(12, seed=7)
    found, _, _ = segment(Scene(bodies, MEDIUM, tilted(0.46, 8, -5), noise_m=0.001))
    errors = [
        np.hypot(*(found.centre_m - [b.place_x_m + 0.2, b.y_m]).T).min()
        for b in bodies
        if -0.15 < b.place_x_m + 0.2 < 0.15
    ]
    assert len(errors) >= 6
    assert max(errors) < 0.003


def test_touching_tubers_are_split_and_masks_fit() -> None:
    bodies = [Body(-0.2 + 0.060 * i, -0.15 + 0.058 * j, 0.033, 0.030, 0.027, yaw=i) for i in range(5) for j in range(6)]
    found, depth, labels = segment(Scene(bodies, MEDIUM, noise_m=0.001, holes=0.02), travel_m=0.08)
    assert len(found) == 30
    score = agreement(np.where(depth > 0, labels, 0), full_resolution(found, depth), least_px=100)
    assert score.f1(0.75) == 1.0
    assert score.panoptic_quality > 0.9


def test_holes_cleats_and_an_empty_belt() -> None:
    empty, _, _ = segment(Scene([], noise_m=0.0015))
    assert len(empty) == 0
    scene = Scene([Body(0.0, 0.0)])
    depth, _ = scene.render(0.0)
    depth[118:123, 205:220] = 0
    depth[40:44, :] -= 8
    belt = BeltGeometry(scene.intrinsics, scene.belt_from_camera)
    found = split(height_map(depth, depth_scale_m=0.001, belt=belt, pixel_mm=1.45), belt, SplitSettings())
    assert len(found) == 1
    assert found.centre_m[0] == pytest.approx([0.0, 0.0], abs=0.001)


def test_small_and_flat_things_are_refused_with_their_reason() -> None:
    things = [Body(0.0, -0.1, 0.009, 0.009, 0.015), Body(0.0, 0.1, 0.05, 0.05, 0.008)]
    found, _, _ = segment(Scene(things, MEDIUM), travel_m=0.0)
    assert len(found) == 0
    assert found.refused["flat"] == 1


def test_given_masks_replace_the_splitter() -> None:
    bodies = scattered(9, seed=3)
    scene = Scene(bodies, MEDIUM)
    depth, labels = scene.render(0.2)
    belt = BeltGeometry(scene.intrinsics, scene.belt_from_camera)
    heights = height_map(depth, depth_scale_m=0.001, belt=belt, pixel_mm=1.45)
    found = given(labels, heights, belt)
    assert len(found) == len(np.unique(labels[labels > 0]))
    errors = [
        np.hypot(*(found.centre_m - [b.place_x_m + 0.2, b.y_m]).T).min()
        for b in bodies
        if abs(b.place_x_m + 0.2) < 0.15
    ]
    assert max(errors) < 0.001


def test_two_empty_label_images_agree() -> None:
    nothing = np.zeros((4, 4), np.uint16)
    assert agreement(nothing, nothing, least_px=1).f1(0.5) == 1.0
