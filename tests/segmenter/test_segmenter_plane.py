"""The belt plane: fitted, given, compared; wrong calibrations are refused with both numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from segmenter_scene import MEDIUM, SMALL, Scene, scattered, tilted

from conveyor.camera_place import CameraPlace
from conveyor.errors import InputError
from conveyor.geometry import belt_distance_m, straight_down_belt_from_camera
from conveyor.messages import Frame
from conveyor.reasons import FrameDrop
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.plane import fit_plane, given_or_fitted, plane_pose
from segmenter.pipeline import Segmenter, Settings


@pytest.mark.parametrize("pose", [straight_down_belt_from_camera(0.345), tilted(0.46, 6, -4), tilted(0.6, -10)])
def test_the_fit_finds_the_belt_behind_tubers_noise_and_holes(pose: np.ndarray) -> None:
    scene = Scene(scattered(18, seed=4, spacing_m=0.09), SMALL, pose, noise_m=0.0015, holes=0.05, seed=5)
    depth, _ = scene.render(0.3)
    fit = fit_plane(depth, depth_scale_m=0.001, intrinsics=SMALL)
    assert fit is not None
    assert fit.distance_m == pytest.approx(belt_distance_m(pose), abs=0.0007)
    np.testing.assert_allclose(plane_pose(fit)[2], pose[2], atol=0.004)
    assert fit.residual_m < 0.002


def test_plane_pose_of_a_straight_camera_is_the_straight_down_pose() -> None:
    depth, _ = Scene([], SMALL).render(0.0)
    fit = fit_plane(depth, depth_scale_m=0.001, intrinsics=SMALL)
    assert fit is not None
    np.testing.assert_allclose(plane_pose(fit), straight_down_belt_from_camera(0.46), atol=1e-6)


def test_no_belt_no_fit() -> None:
    rng = np.random.default_rng(1)
    assert fit_plane(np.zeros((240, 424), np.uint16), depth_scale_m=0.001, intrinsics=SMALL) is None
    rubble = rng.integers(200, 900, (240, 424)).astype(np.uint16)
    assert fit_plane(rubble, depth_scale_m=0.001, intrinsics=SMALL) is None


def test_a_depth_scale_wrong_by_ten_is_named_with_both_distances() -> None:
    frame = Scene(scattered(6, seed=1)).frame(0, 0.2)
    with pytest.raises(InputError, match=r"0\.460 m.*4\.600 m.*depth scale of 0\.01 m is wrong \(try 0\.001\)"):
        step_and_finish(replace(frame, depth_scale_m=0.01))


def test_a_belt_of_another_season_is_refused_with_both_distances() -> None:
    frame = Scene(scattered(6, seed=1)).frame(0, 0.2)
    wrong = replace(frame, belt_from_camera=straight_down_belt_from_camera(0.345))
    with pytest.raises(InputError, match=r"calibrated for a belt at 0\.345 m.*lies at 0\.460 m"):
        step_and_finish(wrong)


def step_and_finish(frame: Frame) -> None:
    """A recording of one frame."""
    core = Segmenter(Settings())
    assert core.step(frame).dropped == FrameDrop.NO_BELT
    core.finish()


def test_a_belt_that_sank_a_little_raises_the_alarm_and_is_measured() -> None:
    frame = Scene(scattered(6, seed=1)).frame(0, 0.2)
    core = Segmenter(Settings())
    core.step(replace(frame, belt_from_camera=straight_down_belt_from_camera(0.450)))
    assert core.belt_check.alarm
    assert core.belt_check.drift_m == pytest.approx(0.010, abs=0.0005)


def test_without_any_calibration_the_belt_is_measured() -> None:
    scene = Scene(scattered(6, seed=1), MEDIUM, tilted(0.40, 5))
    core = Segmenter(Settings())
    core.step(scene.frame(0, 0.2, calibrated=False))
    assert core.belt is not None
    assert core.belt.distance_m == pytest.approx(0.40, abs=0.0007)
    np.testing.assert_allclose(core.belt.belt_from_camera[2], scene.belt_from_camera[2], atol=0.003)


@pytest.mark.parametrize(("tilt_deg", "taken"), [(3.0, True), (-2.2, True), (1.0, False)])
def test_a_pose_that_was_assumed_gets_the_tilt_past_doubt_and_keeps_its_place(tilt_deg: float, taken: bool) -> None:
    """A line's file says where a camera hangs in words: that it looks straight down is then no more than a hope."""
    place = CameraPlace(0.06, -0.3, 175.0)
    true = place.put(tilted(0.46, tilt_deg))
    scene = Scene([], SMALL, true, noise_m=0.001)
    fit = fit_plane(scene.render(0.0)[0], depth_scale_m=0.001, intrinsics=SMALL)
    assumed = place.straight_down(belt_distance_m(true))
    found = given_or_fitted(assumed, None, fit, camera="front")
    np.testing.assert_allclose(found, true if taken else assumed, atol=0.002)
    measured = place.put(tilted(0.46, 0.1))
    assert given_or_fitted(measured, None, fit, camera="front") is measured, "what was measured is believed"


def test_a_tilt_seen_clearly_corrects_a_camera_said_to_look_straight_down() -> None:
    pose = tilted(0.46, 3)
    depth, _ = Scene(scattered(6, seed=1), SMALL, pose).render(0.2)
    fit = fit_plane(depth, depth_scale_m=0.001, intrinsics=SMALL)
    found = given_or_fitted(None, 0.46, fit, camera="front")
    assert belt_distance_m(found) == pytest.approx(0.46, abs=1e-9)
    np.testing.assert_allclose(found[2], pose[2], atol=0.003)


def test_a_belt_that_travels_across_the_image_is_refused() -> None:
    pose = straight_down_belt_from_camera(0.46)[[1, 0, 2, 3]]
    pose[1] *= -1
    with pytest.raises(InputError, match="travels across the image"):
        BeltGeometry(SMALL, pose)


def test_projection_and_deprojection_are_inverse() -> None:
    belt = BeltGeometry(SMALL, tilted(0.5, 7, 3))
    for u, v, height_m in ((10.0, 20.0, 0.0), (400.0, 230.0, 0.05), (212.0, 120.0, 0.03)):
        assert belt.project(*belt.belt_xy(u, v, height_m), height_m) == pytest.approx((u, v), abs=1e-6)
    x_m = belt.row_crossing_x(0.08, 0.03)
    assert belt.project(x_m, 0.08, 0.03)[1] == pytest.approx(SMALL.cy, abs=1e-9)
