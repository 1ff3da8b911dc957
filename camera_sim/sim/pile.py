"""More than one layer: tubers dropped onto those that lie already, each rolling down to where it can sink no deeper."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from camera_sim.sim.meshes import Faces, Vertices
from camera_sim.sim.raster import fill_highest

CELL_M = 0.002
STEP_M = 0.006
TRIES = 12


class Ground:
    """What lies already, seen from above: the height of the highest surface in cells of 2 mm, metres."""

    def __init__(self, *, x_m: tuple[float, float], y_m: tuple[float, float]) -> None:
        self._x0, self._y0 = x_m[0], y_m[0]
        shape = (int((x_m[1] - x_m[0]) / CELL_M) + 2, int((y_m[1] - y_m[0]) / CELL_M) + 2)
        self._height = np.zeros(shape, np.float32)
        self._ids = np.zeros(shape, np.int32)

    def add(self, vertices: Vertices, faces: Faces) -> None:
        """A body that lies at its place, (V, 3) metres."""
        rows, columns = (vertices[:, 0] - self._x0) / CELL_M, (vertices[:, 1] - self._y0) / CELL_M
        fill_highest(self._height, self._ids, columns, rows, vertices[:, 2], faces)

    def rest_height_m(self, points: Vertices, x_m: float, y_m: float) -> float:
        """How high a body must be lifted that lies with z = 0 around (0, 0), to touch the ground at (x, y)."""
        rows = ((points[:, 0] + x_m - self._x0) / CELL_M).astype(int)
        columns = ((points[:, 1] + y_m - self._y0) / CELL_M).astype(int)
        height, width = self._height.shape
        if rows.min() < 0 or columns.min() < 0 or rows.max() >= height or columns.max() >= width:
            return float("inf")
        return max(0.0, float((self._height[rows, columns] - points[:, 2]).max()))


def settle(
    points: Vertices, ground: Ground, rng: Generator, *, x_m: tuple[float, float], y_m: tuple[float, float]
) -> NDArray[np.float64]:
    """(3,) where a body (V, 3) with its lowest point at z = 0 comes to rest within the given stretch."""
    best = (float("inf"), 0.0, 0.0)
    for _ in range(TRIES):
        x, y = float(rng.uniform(*x_m)), float(rng.uniform(*y_m))
        best = min(best, (ground.rest_height_m(points, x, y), x, y))
    while True:
        z, x, y = best
        around = [(x + dx, y + dy) for dx in (-STEP_M, 0.0, STEP_M) for dy in (-STEP_M, 0.0, STEP_M)]
        inside = [(a, b) for a, b in around if x_m[0] <= a <= x_m[1] and y_m[0] <= b <= y_m[1]]
        lower = min((ground.rest_height_m(points, a, b), a, b) for a, b in inside)
        if lower[0] >= z - 1e-4:
            return np.array([x, y, z])
        best = lower
