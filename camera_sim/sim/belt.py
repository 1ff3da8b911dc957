"""The belt as a camera sees it: a relief of cleats and soil on a plane, or a web of rods."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from camera_sim.sim.rods import Rods, rods_depth
from conveyor.geometry import Intrinsics
from conveyor.kernels import kernel

TILE_MM = 1024
CLEAT_WIDTH_MM = 12


@dataclass(frozen=True, slots=True)
class Belt:
    """A relief over the belt plane that repeats every 1.024 m along and across.

    Attributes:
        relief_m: (1024, 1024) float32 metres, rows along the travel, 1 mm apart.
        rods: instead of a solid belt; the relief is then that of the ground below them.
    """

    relief_m: NDArray[np.float32]
    rods: Rods | None = None


def draw_belt(rng: Generator, *, soil_m: float = 0.0012, cleat_m: float = 0.006, pitch_mm: int = 64) -> Belt:
    """A belt with soil of the given rms and cleats of the given height, 12 mm wide, every `pitch_mm` (divides 1024)."""
    k = np.fft.fftfreq(TILE_MM, 1 / TILE_MM)
    coarse, fine = (np.exp(-0.5 * (k / width) ** 2) for width in (18.0, 90.0))
    half = TILE_MM // 2 + 1
    spectrum = np.outer(coarse, coarse[:half]) + 0.08 * np.outer(fine, fine[:half])
    white = np.fft.rfft2(rng.standard_normal((TILE_MM, TILE_MM)))
    soil = np.fft.irfft2(white * spectrum)
    soil = np.maximum(soil / soil.std(), -0.8)
    soil = (soil - soil.mean()) * soil_m
    cleats = cleat_heights_m(cleat_m, pitch_mm, np.arange(TILE_MM))
    return Belt((soil + cleats[:, None]).astype(np.float32))


def cleat_heights_m(cleat_m: float, pitch_mm: int, x_mm: NDArray[np.floating | np.integer]) -> NDArray[np.float64]:
    """Height of cleats over the belt at `x_mm` along it; the first begins at 0."""
    along = x_mm % pitch_mm
    return np.where(along < CLEAT_WIDTH_MM, cleat_m * np.sin(np.pi * along / CLEAT_WIDTH_MM), 0.0)


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
    if belt.rods is not None:
        web = (belt.rods.radius_m, belt.rods.pitch_m, belt.rods.below_m)
        seen: NDArray[np.float32] = rods_depth(
            belt.relief_m, web, belt_from_camera, float(travel_m), pinhole, height, width
        )
        return seen
    depth: NDArray[np.float32] = _depth(belt.relief_m, belt_from_camera, float(travel_m), pinhole, height, width)
    return depth


@kernel(nogil=True)
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
