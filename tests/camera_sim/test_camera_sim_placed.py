"""A live source hangs where the line's file says; a belt that runs across its image is turned to run down it."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from camera_sim.clocked import ClockedSource
from camera_sim.placed import PlacedSource, placed
from conveyor.camera_place import CameraPlace
from conveyor.config_camera import CameraConfig
from conveyor.formats import PolledSource, open_source
from conveyor.messages import Frame
from tests.belts import made_once, simulate

POSE = ((0.0, 1.0, 0.0, 0.06), (1.0, 0.0, 0.0, 0.3), (0.0, 0.0, -1.0, 0.46), (0.0, 0.0, 0.0, 1.0))


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_once(tmp_path_factory, "placed", lambda folder: simulate(folder, scene="singulated", tubers="1"))


def live(recording: Path) -> ClockedSource:
    """A camera that began long ago: its newest frame is there at once."""
    return ClockedSource(open_source(recording), starts_at_s=time.time() - 3600, speed=1.0)


def first(source: object) -> Frame:
    frame = next(iter(source.frames(run="r")))  # type: ignore[attr-defined]
    assert isinstance(frame, Frame)
    return frame


def test_words_and_a_pose_reach_every_frame(recording: Path) -> None:
    by_words = CameraConfig(source="realsense", belt_distance_m=0.46, across_m=0.3, along_m=0.06)
    by_pose = CameraConfig(source="realsense", belt_from_camera=POSE)
    for settings in (by_words, by_pose):
        source = placed(live(recording), settings)
        assert np.array_equal(source.description.belt_from_camera, POSE)
        assert np.array_equal(first(source).belt_from_camera, POSE)
        assert np.array_equal(first(source).depth, first(live(recording)).depth)


def test_a_distance_alone_leaves_the_source_as_it_is(recording: Path) -> None:
    source = live(recording)
    assert placed(source, CameraConfig(source="realsense", belt_distance_m=0.46)) is source
    assert placed(source, CameraConfig(source="realsense")) is source


@pytest.mark.parametrize("turned_deg", [90.0, -90.0])
def test_a_camera_that_was_mounted_a_quarter_turn_round(recording: Path, turned_deg: float) -> None:
    plain = first(live(recording))
    source = PlacedSource(live(recording), CameraPlace(turned_deg=turned_deg).straight_down(0.46))
    frame, k = first(source), source.description.intrinsics
    assert (k.width, k.height) == (plain.intrinsics.height, plain.intrinsics.width)
    assert frame.intrinsics == k
    assert np.array_equal(frame.depth, np.rot90(plain.depth, 1 if turned_deg > 0 else -1))
    assert frame.belt_from_camera is not None
    assert frame.belt_from_camera[0, 1] == pytest.approx(1.0)


def test_what_its_process_asks_of_a_live_source_passes_through(recording: Path) -> None:
    source = PlacedSource(live(recording), np.array(POSE))
    assert isinstance(source, PolledSource)
    asked: list[float] = []
    source.attach(lambda still_s: bool(asked.append(still_s)))
    assert list(source.frames(run="r")) == [], "told to stop before the first frame"
    assert asked
    assert source.reopened is None
    source._inner.reopened = 3  # type: ignore[attr-defined]
    assert source.reopened == 3
