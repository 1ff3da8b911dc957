"""Where a camera hangs, in words and as a pose; what a line's file may say of it."""

from __future__ import annotations

import numpy as np
import pytest

from conveyor.camera_place import CameraPlace
from conveyor.config import parse_config
from conveyor.config_camera import CameraConfig, at_one_place, hang_together
from conveyor.errors import ConfigError
from conveyor.geometry import belt_distance_m, straight_down_belt_from_camera, transform_points

POSE = [[0, 1, 0, 0.06], [1, 0, 0, 0.3], [0, 0, -1, 0.46], [0, 0, 0, 1]]


def test_one_at_the_origin_looks_straight_down() -> None:
    np.testing.assert_array_equal(CameraPlace().straight_down(0.46), straight_down_belt_from_camera(0.46))


def test_across_is_to_the_left_of_who_looks_along_the_travel() -> None:
    """Seen from above, travel upwards, y is to the left: the image's right, as the belt runs down the image."""
    pose = CameraPlace(along_m=0.1, across_m=0.3).straight_down(0.46)
    under, right = transform_points(pose, np.array([[0.0, 0.0, 0.46], [0.05, 0.0, 0.46]]))
    np.testing.assert_allclose(under, [0.1, 0.3, 0.0], atol=1e-12)
    np.testing.assert_allclose(right - under, [0.0, 0.05, 0.0], atol=1e-12)


@pytest.mark.parametrize(("turned_deg", "down"), [(0, [1, 0]), (90, [0, 1]), (180, [-1, 0]), (-90, [0, -1])])
def test_turned_is_from_the_travel_to_the_images_downward_direction(turned_deg: float, down: list[int]) -> None:
    pose = CameraPlace(turned_deg=turned_deg).straight_down(0.46)
    np.testing.assert_allclose(pose[:2, 1], down, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_a_place_is_read_back_and_leaves_height_and_tilt(seed: int) -> None:
    rng = np.random.default_rng(seed)
    place = CameraPlace(*rng.uniform(-2, 2, 2), rng.uniform(-179, 179))
    leaning = CameraPlace(*rng.uniform(-2, 2, 2), rng.uniform(-179, 179)).straight_down(0.5)
    angle = rng.uniform(0, 0.2)
    leaning[:3, :3] = leaning[:3, :3] @ np.array(
        [[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]]
    )
    put = place.put(leaning)
    found = CameraPlace.of(put)
    assert (found.along_m, found.across_m, found.turned_deg) == pytest.approx(
        (place.along_m, place.across_m, place.turned_deg)
    )
    np.testing.assert_allclose(put[2], leaning[2], atol=1e-12)
    assert belt_distance_m(put) == pytest.approx(belt_distance_m(leaning))
    np.testing.assert_allclose(put[:3, :3] @ put[:3, :3].T, np.eye(3), atol=1e-12)


def test_a_line_says_a_place_or_a_pose() -> None:
    by_words = CameraConfig(source="realsense", belt_distance_m=0.46, across_m=0.3, along_m=0.06)
    assert by_words.place == CameraPlace(0.06, 0.3, 0.0)
    assert by_words.pose is None
    by_pose = CameraConfig.model_validate({"source": "realsense", "belt_from_camera": POSE})
    assert by_pose.pose is not None
    np.testing.assert_array_equal(by_pose.pose, POSE)
    assert by_pose.place == CameraPlace(0.06, 0.3, 0.0)
    assert CameraConfig(source="realsense", belt_distance_m=0.46).place is None


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ({"belt_from_camera": POSE, "across_m": 0.3}, "belt_from_camera says it all: remove across_m"),
        ({"belt_from_camera": POSE, "belt_distance_m": 0.46}, "belt_from_camera says it all: remove belt_distance_m"),
        ({"belt_from_camera": [[2, 0, 0, 0], *POSE[1:]]}, "belt_from_camera is no rigid transform"),
        ({"belt_from_camera": POSE[:3]}, "belt_from_camera"),
        ({"across_m": 0.3}, "across_m needs belt_distance_m beside it"),
        ({"belt_distance_m": 0.46, "turned_deg": 270}, "turned_deg"),
    ],
)
def test_what_contradicts_itself_is_refused(section: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        parse_config({"cameras": {"left": {"source": "realsense", **section}}}, where="test")


def test_live_cameras_at_one_place_are_named() -> None:
    """Two that said nothing of it took tubers side by side for one, and nothing was said."""
    live = {"source": "realsense", "belt_distance_m": 0.46}
    sections = {"left": live, "right": live, "far": {**live, "across_m": 0.6}, "old": {"path": "recording"}}
    cameras = parse_config({"cameras": sections}, where="test").cameras
    assert at_one_place(cameras) == ("left", "right")
    assert "cameras left, right are taken to hang at one place" in hang_together(at_one_place(cameras))
    placed = {name: {**live, "across_m": 0.3 * n} for n, name in enumerate(sections)}
    assert at_one_place(parse_config({"cameras": placed}, where="test").cameras) == ()
