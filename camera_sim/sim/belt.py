"""The belt's own relief: slats or cleats across it and soil that sticks to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.random import Generator
from numpy.typing import NDArray

from conveyor.geometry import Intrinsics

TILE_MM = 1024


@dataclass(frozen=True, slots=True)
class Belt:
    """A relief over the belt plane that repeats every 1.024 m along and across.

    `relief_m`: (1024, 1024) float32 metres, rows along the travel, 1 mm apart.
    """

    relief_m: NDArray[np.float32]


def draw_belt(rng: Generator, *, soil_m: float = 0.0012, cleat_m: float = 0.006, pitch_mm: int = 64) -> Belt:
    """A belt with soil of the given rms and cleats of the given height, 12 mm wide, every `pitch_mm` (divides 1024)."""
    k = np.fft.fftfreq(TILE_MM, 1 / TILE_MM)
    radius = np.hypot(k[:, None], k[None, :])
    spectrum = np.exp(-0.5 * (radius / 18.0) ** 2) + 0.08 * np.exp(-0.5 * (radius / 90.0) ** 2)
    white = np.fft.fft2(rng.standard_normal((TILE_MM, TILE_MM)))
    soil = np.fft.ifft2(white * spectrum).real
    soil = np.maximum(soil / soil.std(), -0.8)
    soil = (soil - soil.mean()) * soil_m
    along = np.arange(TILE_MM) % pitch_mm
    cleats = np.where(along < 12, cleat_m * np.sin(np.pi * along / 12), 0.0)
    return Belt((soil + cleats[:, None]).astype(np.float32))


def draw_rods(
    rng: Generator, *, soil_m: float = 0.0012, rod_m: float = 0.012, below_m: float = 0.040, pitch_mm: int = 32
) -> Belt:
    """A web of rods across the belt, their tops at z = 0; between them one sees what lies `below_m` under them.

    Seen through a web the relief is not small: what is below is drawn where its ray meets the belt plane, so it shifts
    with the belt and not against it, and the rods' flanks are not seen.
    """
    soil = draw_belt(rng, soil_m=soil_m, cleat_m=0.0).relief_m
    radius_m = rod_m / 2
    across = (np.arange(TILE_MM) % pitch_mm - pitch_mm / 2 + 0.5) / 1000
    inside = np.abs(across) < radius_m
    rod = np.where(inside, np.sqrt(np.maximum(radius_m**2 - across**2, 0.0)) - radius_m, 0.0)
    return Belt(np.where(inside[:, None], rod[:, None] + 0.2 * soil, soil - below_m).astype(np.float32))


def belt_depth(
    belt: Belt,
    *,
    intrinsics: Intrinsics,
    belt_from_camera: NDArray[np.float64],
    travel_m: float,
    u0: int,
    v0: int,
    height: int,
    width: int,
) -> NDArray[np.float32]:
    """(h, w) float32 depth of the belt along the optical axis, metres, for a window of the image.

    Args:
        belt_from_camera: (4, 4) rigid.
        travel_m: how far the belt has moved.
        u0, v0, height, width: the window.
    """
    pinhole = (intrinsics.fx, intrinsics.fy, intrinsics.cx - u0, intrinsics.cy - v0)
    depth: NDArray[np.float32] = _depth(belt.relief_m, belt_from_camera, float(travel_m), pinhole, height, width)
    return depth


@njit(cache=True, nogil=True)
def _depth(
    relief: NDArray[np.float32],
    belt_from_camera: NDArray[np.float64],
    travel: float,
    pinhole: tuple[float, float, float, float],
    height: int,
    width: int,
) -> NDArray[np.float32]:
    """Meet each ray with the plane, look the relief up there, and meet the raised plane: relief is small."""
    fx, fy, cx, cy = pinhole
    m = belt_from_camera
    out = np.empty((height, width), np.float32)
    for v in range(height):
        ray_y = (v - cy) / fy
        for u in range(width):
            ray_x = (u - cx) / fx
            down = -(m[2, 0] * ray_x + m[2, 1] * ray_y + m[2, 2])
            z = m[2, 3] / down
            x = (m[0, 0] * ray_x + m[0, 1] * ray_y + m[0, 2]) * z + m[0, 3] - travel
            y = (m[1, 0] * ray_x + m[1, 1] * ray_y + m[1, 2]) * z + m[1, 3]
            i = int(np.floor(x * 1000.0)) & (TILE_MM - 1)
            j = int(np.floor(y * 1000.0)) & (TILE_MM - 1)
            out[v, u] = (m[2, 3] - relief[i, j]) / down
    return out
