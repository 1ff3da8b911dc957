"""A web of rods across the belt: where a sphere lies on it, and what a camera sees of it, flanks included."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel

SOIL_ON_RODS = 0.2
"""Share of the belt's soil that sticks to the rods."""


@dataclass(frozen=True, slots=True)
class Rods:
    """Round rods along y whose tops lie at z = 0, one every `pitch_m`; the first centre lies at x = `pitch_m` / 2.

    Attributes:
        radius_m: of one rod; 10.5 mm (7/16 inch) and 12 mm are usual diameters.
        pitch_m: centre to centre; 28 to 50 mm are sold.
        below_m: how far under the rods' tops the ground lies that one sees between them.
    """

    radius_m: float = 0.006
    pitch_m: float = 0.032
    below_m: float = 0.040

    @property
    def gap_m(self) -> float:
        """Between two rods; a tuber that is slimmer falls through."""
        return self.pitch_m - 2 * self.radius_m

    def heights_m(self, step_m: float) -> NDArray[np.float64]:
        """(n,) height of the web at n even steps of about `step_m` over one pitch from x = 0; -inf beside the rod."""
        count = max(8, round(self.pitch_m / step_m))
        x = np.arange(count) * (self.pitch_m / count) - self.pitch_m / 2
        inside = np.maximum(self.radius_m**2 - x**2, 0.0)
        return np.where(np.abs(x) < self.radius_m, np.sqrt(inside) - self.radius_m, -np.inf)


@kernel(nogil=True)
def rods_depth(
    soil: NDArray[np.float32],
    web: tuple[float, float, float],
    belt_from_camera: NDArray[np.float64],
    travel: float,
    pinhole: tuple[float, float, float, float],
    height: int,
    width: int,
) -> NDArray[np.float32]:
    """(h, w) float32 depth of the nearest rod on each ray, else of the ground below, metres.

    Args:
        soil: (n, n) float32 metres, n a power of 2, 1 mm apart: relief of the ground; a fifth of it lies on the rods.
        web: radius, pitch, below of `Rods`.
        travel: how far the belt has moved; pinhole: fx, fy, cx, cy of the window.
    """
    radius, pitch, below = web
    fx, fy, cx, cy = pinhole
    m = belt_from_camera
    last = soil.shape[0] - 1
    out = np.empty((height, width), np.float32)
    ox, oz = m[0, 3] - travel, m[2, 3]
    for v in range(height):
        ray_y = (v - cy) / fy
        for u in range(width):
            ray_x = (u - cx) / fx
            dx = m[0, 0] * ray_x + m[0, 1] * ray_y + m[0, 2]
            dz = m[2, 0] * ray_x + m[2, 1] * ray_y + m[2, 2]
            enters = ox - dx * oz / dz
            leaves = ox - dx * (oz + 2 * radius) / dz
            first = int(np.ceil((min(enters, leaves) - radius) / pitch - 0.5))
            final = int(np.floor((max(enters, leaves) + radius) / pitch - 0.5))
            best = np.inf
            a = dx * dx + dz * dz
            for i in range(first, final + 1):
                ax, az = ox - (i + 0.5) * pitch, oz + radius
                b = ax * dx + az * dz
                inside = b * b - a * (ax * ax + az * az - radius * radius)
                if inside > 0:
                    best = min(best, (-b - np.sqrt(inside)) / a)
            t = best if best < np.inf else -(oz + below) / dz
            dy = m[1, 0] * ray_x + m[1, 1] * ray_y + m[1, 2]
            row = int(np.floor((ox + dx * t) * 1000.0)) & last
            column = int(np.floor((m[1, 3] + dy * t) * 1000.0)) & last
            share = SOIL_ON_RODS if best < np.inf else 1.0
            out[v, u] = t + share * soil[row, column] / dz
    return out
