"""The recording of `tuberline demo`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from camera_sim.sim.optics import D405_848
from camera_sim.sim.placement import Packing
from camera_sim.sim.presets import EASY_PRESET
from camera_sim.sim.record import record_scene
from camera_sim.sim.scenes import Layout, SceneSettings

DEMO_LAYOUT = Layout(
    Packing(tries=2, touching=0.3, gap_m=0.11, aside_m=0.0),
    lanes_m=((-0.42, -0.06), (0.06, 0.42)),
    cameras=(("left", 0.0, -0.28), ("right", 0.05, 0.28)),
)
DEMO_SETTINGS = SceneSettings("demo", seed=5, tubers=48, preset=EASY_PRESET, optics=D405_848, fps=15.0)


def demo_recording(out: Path) -> dict[str, Any]:
    """The recording of `tuberline demo`: two overlapping cameras over two lanes, the same on every machine."""
    return record_scene(out, DEMO_SETTINGS, layout=DEMO_LAYOUT)
