"""A recording of two cameras that hang as hands leave them, and that says no more of it than their distance."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from segmenter_scene import SMALL, Body, Scene

from conveyor.camera_place import CameraPlace
from conveyor.formats.folder.writer import FolderWriter
from conveyor.formats.source import CameraDescription

DISTANCE_M, FPS, STEP_M = 0.46, 15.0, 0.02
BELT_M, LEAST_APART_M = 0.7, 0.10
PLACES = {"left": CameraPlace(0.0, -0.22, 4.0), "right": CameraPlace(0.03, 0.25, 178.0)}


def belt(seed: int, *, half_width_m: float = 0.62) -> list[Body]:
    """Tubers of many sizes at random places, none nearer than `LEAST_APART_M` to another."""
    rng = np.random.default_rng(seed)
    bodies: list[Body] = []
    for _ in range(4000):
        x_m, y_m = -rng.uniform(0.0, BELT_M), rng.uniform(-half_width_m, half_width_m)
        if all(np.hypot(x_m - b.place_x_m, y_m - b.y_m) > LEAST_APART_M for b in bodies):
            a_m, b_m, c_m = np.sort(rng.uniform(0.022, 0.038, 3))[::-1]
            bodies.append(Body(x_m, y_m, float(a_m), float(b_m), float(c_m), float(rng.uniform(0, np.pi))))
    return bodies


def record(
    folder: Path, bodies: list[Body], *, places: Mapping[str, CameraPlace] = PLACES, encoder: bool = True
) -> dict[str, NDArray[np.float64]]:
    """Write what the cameras see while all of the belt passes; their true poses, (4, 4) by name."""
    poses = {name: place.straight_down(DISTANCE_M) for name, place in places.items()}
    view_m = DISTANCE_M * SMALL.height / SMALL.fy
    first_m, last_m = -view_m / 2 - 0.1, BELT_M + view_m / 2 + 0.15
    for name, pose in poses.items():
        scene = Scene(bodies, SMALL, pose, noise_m=0.0008, seed=len(name))
        described = CameraDescription(name, "test", SMALL, 0.001, DISTANCE_M, None, FPS, None)
        with FolderWriter(folder, described) as writer:
            for seq, travel_m in enumerate(np.arange(first_m, last_m, STEP_M)):
                frame = scene.frame(seq, float(travel_m), fps=FPS, encoder=encoder, calibrated=False)
                writer.write(frame)
    return poses
