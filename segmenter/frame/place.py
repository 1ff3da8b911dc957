"""Where an instance lies on the belt, free of the lean that its visible side has, and how big it is.

The mean of the visible side leans 4-5 % of the offset towards the optical axis. The silhouette does not: for an
ellipsoid of vertical half-axis c whose centre lies D below the camera, the rays tangent to it meet the plane of its
centre in an outline whose middle is the true offset times 1 / (1 - (c/D)^2), so the ray through the mask's centroid,
met with that plane and scaled back by (1 - (c/D)^2), is its centre.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from segmenter.frame.belt import BeltGeometry


def centre_in_belt(belt: BeltGeometry, u: float, v: float, height_m: float) -> tuple[float, float]:
    """Belt (x, y) of the centre of a tuber `height_m` high whose mask has its centroid at pixel (u, v), metres."""
    half_m = height_m / 2
    x_m, y_m = belt.belt_xy(u, v, half_m)
    x0, y0, z0 = belt.camera_place_m
    keep = 1.0 - (half_m / (z0 - half_m)) ** 2
    return x0 + (x_m - x0) * keep, y0 + (y_m - y0) * keep


def outline_size_m(belt: BeltGeometry, outline_px: NDArray[np.float32], height_m: float) -> tuple[float, float]:
    """(length, width) of the smallest rectangle around an outline, met with the plane of the tuber's half height.

    Args:
        belt: geometry.
        outline_px: (N, 2) float32 pixels (u, v).
        height_m: height of the tuber.
    """
    k, m = belt.intrinsics, belt.belt_from_camera
    a, b, c, t = belt.height_coefficients()
    u, v = outline_px[:, 0].astype(np.float64), outline_px[:, 1].astype(np.float64)
    z = (height_m / 2 - t) / (a * u + b * v + c)
    in_camera = np.stack([(u - k.cx) / k.fx * z, (v - k.cy) / k.fy * z, z], axis=1)
    in_belt_mm = ((in_camera @ m[:2, :3].T + m[:2, 3]) * 1000.0).astype(np.float32)
    _, sides, _ = cv2.minAreaRect(cv2.convexHull(in_belt_mm))
    return max(sides) / 1000.0, min(sides) / 1000.0


def free_ellipse_centre(
    outline_px: NDArray[np.float32], *, first_u: float, last_u: float, margin: float
) -> tuple[float, float] | None:
    """Centre (u, v) of the ellipse through the free part of an outline cut at its left or right.

    Args:
        outline_px: (N, 2) float32 pixels (u, v).
        first_u, last_u: columns of the cuts, pixels; far outside where that side is not cut.
        margin: outline closer to a cut than this is the cut, not the tuber, pixels.

    Returns:
        None where too little of the outline is free for an ellipse that means anything.
    """
    free = outline_px[(outline_px[:, 0] > first_u + margin) & (outline_px[:, 0] < last_u - margin)]
    if len(free) < 12:
        return None
    (u, v), axes, _ = cv2.fitEllipseDirect(np.ascontiguousarray(free))
    span = float(np.ptp(outline_px, axis=0).max())
    if not np.isfinite([u, v, *axes]).all() or max(axes) > 2.5 * span or min(axes) <= 0:
        return None
    return float(u), float(v)
