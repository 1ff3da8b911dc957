"""A bar on the frame as a gauge: how much nearer than the belt its level top is, in 1/z.

A drift of disparity adds the same to 1/z of bar and belt, so the difference of the two does not know it, and gives the
true distance alone. The top is level: of a round body beside the optical axis a camera that moved sees another part,
and that looks like no change at all.
"""

from __future__ import annotations

import numpy as np

from conveyor.messages import Frame
from segmenter.frame.belt import BeltGeometry

INNER = 0.6
"""Share of the top, along and across, that is looked at, away from its outline."""
LEAST_SEEN = 0.5
LEAST_PIXELS = 60
REACH_M = 0.03
"""How far from its calibrated distance the belt is looked for."""


def bar_distance_m(
    frame: Frame,
    belt: BeltGeometry,
    *,
    size_m: tuple[float, float],
    place_m: tuple[float, float, float],
    seen_m: float,
) -> float | None:
    """Camera to belt along the optical axis, metres, by the bar; None where its top is not seen.

    Args:
        size_m: of its top, along and across the belt; place_m: (x, y, z) the middle of it in belt coordinates.
        seen_m: how far the belt plane seems along the optical axis.
    """
    k, m = belt.intrinsics, belt.belt_from_camera
    half = INNER * np.array(size_m) / 2
    corners = [
        belt.project(place_m[0] + i * half[0], place_m[1] + j * half[1], place_m[2]) for i in (-1, 1) for j in (-1, 1)
    ]
    (u0, v0), (u1, v1) = (np.array(corners).min(axis=0).astype(int), np.array(corners).max(axis=0).astype(int) + 1)
    if u0 < 0 or v0 < 0 or u1 >= k.width or v1 >= k.height:
        return None
    depth = frame.depth[v0:v1, u0:u1]
    v, u = np.nonzero(depth)
    if depth.size < LEAST_PIXELS or len(v) < LEAST_SEEN * depth.size:
        return None
    inverse = 1 / (depth[v, u] * frame.depth_scale_m)
    a, b, c, t = belt.height_coefficients()
    up = a * (u + u0) + b * (v + v0) + c
    level_m, down = (place_m[2] - t) / up, float(m[2, 2]) / up

    def apart(shift_m: float) -> float:
        """Drift of the bar's 1/z less that of the belt's, if the camera had moved by `shift_m`."""
        by_bar = float(np.mean(inverse - 1 / (level_m + shift_m * down)))
        return by_bar - (1 / seen_m - 1 / (belt.distance_m + shift_m))

    low_m, high_m = -REACH_M, REACH_M
    if apart(low_m) * apart(high_m) > 0:
        return None
    for _ in range(30):
        middle_m = (low_m + high_m) / 2
        if apart(low_m) * apart(middle_m) <= 0:
            high_m = middle_m
        else:
            low_m = middle_m
    return belt.distance_m + (low_m + high_m) / 2
