"""The belt's width as a gauge: from edge to edge by the depth of the plane that is seen, against the known width."""

from __future__ import annotations

import numpy as np

from conveyor.messages import Frame
from segmenter.frame.belt import BeltGeometry
from segmenter.gauge.points import depths_m, rays

ABOVE_M, BELOW_M = 0.10, 0.012
"""What lies so far over the plane is load on the belt, and so far under it still belt; the floor lies lower."""
EDGE_PX = 4
"""Nearer to the image's edge it is the image that ends and not the belt."""
LEAST_ROWS = 60
WITHIN = 0.05
"""Share by which a row's width may be off: what is more is a tuber over the edge."""


def width_scale(frame: Frame, belt: BeltGeometry, *, width_m: float, seen_m: float) -> float | None:
    """The belt's width as seen, as a share of the known one; None where its two edges are not in view.

    Args:
        seen_m: how far the belt plane seems along the optical axis.
    """
    z = depths_m(frame, stride=1)
    _, across, up = rays(frame, belt, stride=1)
    lower_m = (belt.distance_m - seen_m) * -float(belt.belt_from_camera[2, 2])
    height = z * up + belt.belt_from_camera[2, 3] - lower_m
    on = (height > -BELOW_M) & (height < ABOVE_M)
    rows = np.flatnonzero(on.sum(axis=1) > 0.3 * on.shape[1])
    if len(rows) < LEAST_ROWS:
        return None
    first = on[rows].argmax(axis=1)
    last = on.shape[1] - 1 - on[rows][:, ::-1].argmax(axis=1)
    inside = (first >= EDGE_PX) & (last < on.shape[1] - EDGE_PX)
    rows, first, last = rows[inside], first[inside], last[inside]
    # Depth of the plane and not of the pixel: an edge's own depth is noise.
    plane = (lower_m - belt.belt_from_camera[2, 3]) / up
    one = plane[rows, first] * across[rows, first]
    other = plane[rows, last] * across[rows, last]
    shares = np.abs(other - one) / width_m
    shares = shares[np.abs(shares - 1) < WITHIN]
    return float(np.median(shares)) if len(shares) >= LEAST_ROWS else None
