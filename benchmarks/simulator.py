"""CPU time that the simulator takes for a frame, by scene and resolution.

`python -m benchmarks simulator`. One thread, process time, median of 20 frames in the middle of a run of 30 tubers.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from benchmarks.options import parser_of
from camera_sim.sim.optics import ALL_OPTICS, optics_named
from camera_sim.sim.presets import EASY_PRESET
from camera_sim.sim.scenes import SceneSettings, build_world, layout_named
from camera_sim.sim.source import simulated_sources

FRAMES = 20


def main(arguments: Sequence[str]) -> None:
    """Measure and say."""
    parser = parser_of("simulator", __doc__)
    parser.add_argument("--scenes", nargs="+", default=["touching", "crowded", "piled", "rolling", "rods"])
    options = parser.parse_args(arguments)
    for camera in sorted(ALL_OPTICS, reverse=True):
        for scene in options.scenes:
            frame_ms = frame_cpu_ms(scene, camera)
            print(f"{camera:10} {scene:10} {frame_ms:5.1f} ms a frame, {1000 / frame_ms:4.0f} frames/s on one core")


def frame_cpu_ms(scene: str, camera: str) -> float:
    """Median CPU time of a frame, milliseconds; compilation and noise fields are made before."""
    settings = SceneSettings(scene, seed=3, tubers=30, preset=EASY_PRESET, optics=optics_named(camera))
    layout = layout_named(scene)
    source = simulated_sources(build_world(settings, layout), settings, layout)[0]
    first = (source.description.frames or 0) // 3
    source.frame(first, run="benchmark")
    taken_s = []
    for seq in range(first, first + FRAMES):
        started = time.process_time()
        source.frame(seq, run="benchmark")
        taken_s.append(time.process_time() - started)
    return 1000 * float(np.median(taken_s))
