"""The belt as one camera sees it: heights, belt coordinates of pixels, and the row where tubers are counted."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError
from conveyor.geometry import Intrinsics, belt_distance_m, height_coefficients

MIN_ROW_ALIGNMENT = 0.5
"""How much of the belt's travel must run along the image's rows for a tuber to cross the centre row at all."""


@dataclass(frozen=True, slots=True)
class BeltGeometry:
    """Intrinsics and belt pose of one camera. All lengths in metres, pixels as floats (0, 0 = first pixel's centre).

    Raises:
        InputError: the camera does not look down on the belt, or the belt does not travel along the image's rows.
    """

    intrinsics: Intrinsics
    belt_from_camera: NDArray[np.float64]
    _rows: tuple[tuple[float, float, float, float], ...] = field(init=False, repr=False, compare=False)
    """Of the pose, as Python's own numbers: asked for some hundred times a frame."""
    _heights: tuple[float, float, float, float] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        belt_distance_m(self.belt_from_camera)
        rows = tuple(tuple(row) for row in np.asarray(self.belt_from_camera, np.float64).tolist())
        object.__setattr__(self, "_rows", rows)
        object.__setattr__(self, "_heights", height_coefficients(self.intrinsics, self.belt_from_camera))
        along = float(self.belt_from_camera[0, 1])
        if abs(along) < MIN_ROW_ALIGNMENT:
            raise InputError(
                f"belt_from_camera says that the belt travels across the image (x along rows: {along:.2f}, at least "
                f"{MIN_ROW_ALIGNMENT} is needed): tubers are counted where they cross the centre row, so turn the "
                "camera by 90 degrees or correct the calibration"
            )

    @property
    def distance_m(self) -> float:
        """Camera to belt along the optical axis."""
        return belt_distance_m(self.belt_from_camera)

    @property
    def camera_place_m(self) -> tuple[float, float, float]:
        """x, y and z of the optical centre in belt coordinates."""
        return self._rows[0][3], self._rows[1][3], self._rows[2][3]

    def height_coefficients(self) -> tuple[float, float, float, float]:
        """(a, b, c, t) such that a pixel (u, v) at depth z lies z * (a u + b v + c) + t above the belt."""
        return self._heights

    def depth_at(self, u: float, v: float, height_m: float) -> float:
        """Depth along the optical axis at which the ray through (u, v) is `height_m` above the belt."""
        a, b, c, t = self._heights
        return (height_m - t) / (a * u + b * v + c)

    def belt_xy(self, u: float, v: float, height_m: float) -> tuple[float, float]:
        """Belt (x, y) where the ray through pixel (u, v) meets the plane `height_m` above the belt."""
        k, (along, across, *_) = self.intrinsics, self._rows
        z = self.depth_at(u, v, height_m)
        x_cam, y_cam = (u - k.cx) / k.fx * z, (v - k.cy) / k.fy * z
        return (
            along[0] * x_cam + along[1] * y_cam + along[2] * z + along[3],
            across[0] * x_cam + across[1] * y_cam + across[2] * z + across[3],
        )

    def project(self, x_m: float, y_m: float, height_m: float) -> tuple[float, float]:
        """Pixel (u, v) of a belt point."""
        k, m = self.intrinsics, self.belt_from_camera
        x, y, z = m[:3, :3].T @ (np.array([x_m, y_m, height_m]) - m[:3, 3])
        return float(k.cx + k.fx * x / z), float(k.cy + k.fy * y / z)

    def row_crossing_x(self, y_m: float, height_m: float) -> float:
        """Belt x at which a point at (y, height) projects onto the image's centre row, v = cy."""
        along, across, up, *_ = self._rows
        return along[3] - (across[1] * (y_m - across[3]) + up[1] * (height_m - up[3])) / along[1]

    def x_range(self, height_m: float = 0.0) -> tuple[float, float]:
        """Lowest and highest belt x seen on the image's centre column at `height_m`."""
        k = self.intrinsics
        first = self.belt_xy(k.cx, -0.5, height_m)[0]
        last = self.belt_xy(k.cx, k.height - 0.5, height_m)[0]
        return min(first, last), max(first, last)

    def footprint_mm(self, height_m: float = 0.025) -> float:
        """Size of one pixel on the plane `height_m` above the belt, at the image's centre, millimetres."""
        k = self.intrinsics
        return (self.distance_m - height_m) * 1000.0 / float(np.sqrt(k.fx * k.fy))
