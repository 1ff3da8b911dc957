"""Small recordings for the tests of the camera and of the formats."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from camera_sim.sim.optics import Optics
from camera_sim.sim.presets import EASY_PRESET
from camera_sim.sim.record import record_scene
from camera_sim.sim.scenes import SceneSettings
from conveyor.geometry import Intrinsics
from tests.belts import made_once

SMALL = Optics("small", Intrinsics(320, 180, 163.4, 163.0, 160.9, 91.5))
"""A quarter of the D405's 1280x720 a side, so that scenes render in milliseconds."""


SETTINGS = SceneSettings("touching", seed=3, tubers=6, preset=EASY_PRESET, optics=SMALL, fps=10.0, belt_distance_m=0.46)


@pytest.fixture
def small_settings() -> SceneSettings:
    """Six touching tubers at 10 frames/s."""
    return SETTINGS


@pytest.fixture(scope="session")
def small_recording_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording that `small_recording` is a copy of; no test writes to it."""
    return made_once(tmp_path_factory, "small", lambda folder: record_scene(folder, SETTINGS, masks=True, color=True))


@pytest.fixture
def small_recording(small_recording_once: Path, tmp_path: Path) -> Path:
    """A folder recording of one camera, with masks and colour; the test's own."""
    return shutil.copytree(small_recording_once, tmp_path / "recording")
