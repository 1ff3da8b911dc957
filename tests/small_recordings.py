"""Small recordings for the tests of the camera and of the formats."""

from __future__ import annotations

from pathlib import Path

import pytest

from camera_sim.sim.optics import Optics
from camera_sim.sim.presets import EASY_PRESET
from camera_sim.sim.record import record_scene
from camera_sim.sim.scenes import SceneSettings
from conveyor.geometry import Intrinsics

SMALL = Optics("small", Intrinsics(320, 180, 163.4, 163.0, 160.9, 91.5))
"""A quarter of the D405's 1280x720 a side, so that scenes render in milliseconds."""


@pytest.fixture
def small_settings() -> SceneSettings:
    """Six touching tubers at 10 frames/s."""
    return SceneSettings("touching", seed=3, tubers=6, preset=EASY_PRESET, optics=SMALL, fps=10.0, belt_distance_m=0.46)


@pytest.fixture
def small_recording(small_settings: SceneSettings, tmp_path: Path) -> Path:
    """A folder recording of one camera, with masks and colour."""
    record_scene(tmp_path / "recording", small_settings, masks=True, color=True)
    return tmp_path / "recording"
