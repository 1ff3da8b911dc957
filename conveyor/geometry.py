"""Camera and belt geometry: intrinsics, the belt frame, deprojection.

Frames: *camera* x right (image u), y down (image v), z forward, metres. *Belt* x along the travel, y across,
z up from the belt surface, metres. Transforms are named `a_from_b` and map points of b into a.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from conveyor.errors import InputError
from conveyor.ranges import Range

MAX_SIDE_PIXELS = 16384
TYPICAL_BELT_SD_M = 0.002
"""How well a belt's height is known where nothing says it, standard deviation: measured once, worn and soiled since."""
EARTH_M_PER_DEG = 111_320.0
"""Metres of a degree of latitude; of longitude, times the cosine of the latitude."""


def beside_deg(lon_deg: ArrayLike, middle_deg: float) -> NDArray[np.float64]:
    """Longitudes within 180 degrees of `middle_deg`, so that a field on the 180th meridian is drawn in one piece: some
    of them are beyond 180 there.
    """
    lon = np.asarray(lon_deg, np.float64)
    return lon + 360.0 * np.round((middle_deg - lon) / 360.0)


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """Pinhole intrinsics in pixels for an undistorted image of `width` x `height`."""

    width: Annotated[int, Range(1, MAX_SIDE_PIXELS, "px")]
    height: Annotated[int, Range(1, MAX_SIDE_PIXELS, "px")]
    fx: Annotated[float, Range(1e-3, 1e6, "px")]
    fy: Annotated[float, Range(1e-3, 1e6, "px")]
    cx: Annotated[float, Range(-1e6, 1e6, "px")]
    cy: Annotated[float, Range(-1e6, 1e6, "px")]

    def __post_init__(self) -> None:
        if not (0 < self.width <= MAX_SIDE_PIXELS and 0 < self.height <= MAX_SIDE_PIXELS):
            raise InputError(f"image size {self.width}x{self.height} is outside 1..{MAX_SIDE_PIXELS} pixels a side")
        if not (1e-3 <= self.fx <= 1e6 and 1e-3 <= self.fy <= 1e6):
            raise InputError(f"focal lengths must be 0.001 to 1,000,000 pixels, got fx={self.fx}, fy={self.fy}")
        if not (abs(self.cx) <= 1e6 and abs(self.cy) <= 1e6):
            raise InputError(f"the principal point must lie within 1,000,000 pixels, got cx={self.cx}, cy={self.cy}")


def straight_down_belt_from_camera(belt_distance_m: float) -> NDArray[np.float64]:
    """(4, 4) transform of a camera that looks straight down from `belt_distance_m` above the belt.

    Belt x runs along the image's +v (rows), belt y along +u (columns), belt z up; the origin lies on the belt
    under the optical centre.
    """
    return np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [1.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, -1.0, belt_distance_m],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def belt_distance_m(belt_from_camera: NDArray[np.float64]) -> float:
    """Distance from the optical centre to the belt along the optical axis, metres (the paper's H_cam)."""
    down = -float(belt_from_camera[2, 2])
    if down <= 0.1:
        raise InputError(
            f"belt_from_camera points the optical axis away from the belt (z row {belt_from_camera[2].tolist()}); "
            "the camera must look down on it"
        )
    return float(belt_from_camera[2, 3]) / down


def height_coefficients(
    intrinsics: Intrinsics, belt_from_camera: NDArray[np.float64]
) -> tuple[float, float, float, float]:
    """(a, b, c, t) such that a pixel (u, v) at depth z lies z * (a u + b v + c) + t above the belt, metres."""
    x, y, z, t = np.asarray(belt_from_camera[2], np.float64).tolist()
    a, b = x / intrinsics.fx, y / intrinsics.fy
    return a, b, z - a * intrinsics.cx - b * intrinsics.cy, t


def deproject(
    depth: NDArray[np.uint16],
    *,
    depth_scale_m: float,
    intrinsics: Intrinsics,
    u0: int = 0,
    v0: int = 0,
) -> NDArray[np.float32]:
    """Points of all non-zero pixels, raster order.

    Args:
        depth: (h, w) uint16, units of `depth_scale_m` metres, 0 = no depth; may be a crop.
        depth_scale_m: metres per unit.
        intrinsics: of the full image.
        u0, v0: column and row of the crop's first pixel in the full image.

    Returns:
        (N, 3) float32, camera frame, metres.
    """
    v, u = np.nonzero(depth)
    z = depth[v, u].astype(np.float64) * depth_scale_m
    x = (u + u0 - intrinsics.cx) * z / intrinsics.fx
    y = (v + v0 - intrinsics.cy) * z / intrinsics.fy
    return np.stack([x, y, z], axis=1).astype(np.float32)


def transform_points(a_from_b: NDArray[np.float64], points_in_b: NDArray[np.floating]) -> NDArray[np.float64]:
    """(N, 3) points of frame b in frame a, for a rigid (4, 4) transform."""
    return points_in_b @ a_from_b[:3, :3].T + a_from_b[:3, 3]


def inverse_rigid(a_from_b: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4, 4) b_from_a of a rigid transform."""
    b_from_a = np.eye(4)
    b_from_a[:3, :3] = a_from_b[:3, :3].T
    b_from_a[:3, 3] = -a_from_b[:3, :3].T @ a_from_b[:3, 3]
    return b_from_a


Box = tuple[slice, slice]


def box_around(inside: NDArray[np.bool_]) -> Box:
    """Rows and columns of the smallest box around what is marked in (h, w); of no pixel where nothing is."""
    rows, columns = np.flatnonzero(inside.any(1)), np.flatnonzero(inside.any(0))
    if not len(rows):
        return slice(0, 0), slice(0, 0)
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def at_border(box: Box, intrinsics: Intrinsics, *, u0: int = 0, v0: int = 0) -> bool:
    """Whether what a box holds touches the border of the image, so that a part of it may lie outside; `u0`, `v0`: where
    the box is counted from.
    """
    rows, columns = box
    first = 0 in (v0 + rows.start, u0 + columns.start)
    return first or v0 + rows.stop == intrinsics.height or u0 + columns.stop == intrinsics.width
