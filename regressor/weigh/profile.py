"""How a tuber's surface falls from its top to its outline: what tells a full body from a slim one, and how it lies.

An ellipsoid weighs by its outline and its height alone, in any pose. What real bodies weigh besides follows from how
full they are: whether they fall soon and evenly, or stay high and drop at the rim. Heights are taken in rings that
follow the outline at shares of its largest inscribed circle, so they mean the same for round and long tubers; what a
camera loses at the rim takes away the outermost ring alone.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel

RINGS = (0.08, 0.18, 0.32, 0.50, 0.75)
"""Outer ends of all rings but the last, as shares of the inscribed circle's radius."""
SECTIONS = (0.60, 0.78, 0.93)
"""Of the height: where further cross sections are taken."""
UNEVEN_RINGS = 3

PROFILE_NAMES = (
    *("inradius_mm", "major_mm", "minor_mm"),
    *(f"ring{n}" for n in range(1, len(RINGS) + 2)),
    *(f"uneven{n}" for n in range(1, UNEVEN_RINGS + 1)),
    *("area60_cm2", "area78_cm2", "area93_cm2"),
    *("cap_ml", "sloping", "saddle"),
)
"""`inradius_mm`: radius of the largest circle in the outline. `major_mm`, `minor_mm`: twice the standard deviations of
the outline's area along its main axes. `ring1` (outermost) to `ring6`: mean height over the top's. `uneven1` to
`uneven3`: standard deviation of those of the outer three. `area60_cm2` and on: what is higher than that share.
`cap_ml`: the volume above the outermost ring's mean height. `sloping`, `saddle`: how the ring's heights vary once and
twice around the middle."""
COUNT = len(PROFILE_NAMES)


def rim_profile(
    level: NDArray[np.float64],
    areas_m2: NDArray[np.float64],
    inside: NDArray[np.bool_],
    *,
    heights: NDArray[np.float64],
    height_m: float,
) -> NDArray[np.float64]:
    """(18,) in the order of `PROFILE_NAMES`.

    Args:
        level: (N, 3) metres, level frame, of the pixels that `inside` marks, in raster order.
        areas_m2: (N,) area on the level plane that each pixel covers.
        inside: (h, w) the outline, holes filled.
        heights: (N,) above the resting level, metres; height_m: of the top, above 0.
    """
    framed = cv2.copyMakeBorder(inside.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    distance = np.asarray(cv2.distanceTransform(framed, cv2.DIST_L2, cv2.DIST_MASK_5), np.float32)[1:-1, 1:-1]
    found: NDArray[np.float64] = _profile(level, areas_m2, inside, distance, heights, height_m)
    return found


@kernel(nogil=True)
def _axes(level: NDArray[np.float64], areas_m2: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """(x, y of the outline's middle, standard deviations of its area along its main axes), metres."""
    area, x, y, xx, xy, yy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(len(areas_m2)):
        a = areas_m2[k]
        area += a
        x += a * level[k, 0]
        y += a * level[k, 1]
        xx += a * level[k, 0] * level[k, 0]
        xy += a * level[k, 0] * level[k, 1]
        yy += a * level[k, 1] * level[k, 1]
    x, y = x / area, y / area
    xx, xy, yy = xx / area - x * x, xy / area - x * y, yy / area - y * y
    half, root = (xx + yy) / 2, np.sqrt(((xx - yy) / 2) ** 2 + xy * xy)
    return x, y, np.sqrt(max(half + root, 0.0)), np.sqrt(max(half - root, 0.0))


@kernel(nogil=True)
def _profile(
    level: NDArray[np.float64],
    areas_m2: NDArray[np.float64],
    inside: NDArray[np.bool_],
    distance: NDArray[np.float32],
    heights: NDArray[np.float64],
    height_m: float,
) -> NDArray[np.float64]:
    n, rings = len(heights), len(RINGS) + 1
    x, y, major_m, minor_m = _axes(level, areas_m2)
    rows, columns = inside.shape
    most = 0.0
    for v in range(rows):
        for u in range(columns):
            most = max(most, float(distance[v, u]))
    limits = np.array(RINGS) * most
    total, square, share, sections = np.zeros(rings), np.zeros(rings), np.zeros(rings), np.zeros(len(SECTIONS))
    once_c, once_s, twice_c, twice_s, ring_area, circle = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    k = 0
    for v in range(rows):
        for u in range(columns):
            if not inside[v, u]:
                continue
            ring = 0
            while ring < rings - 1 and distance[v, u] > limits[ring]:
                ring += 1
            a, high = areas_m2[k], heights[k] / height_m
            share[ring] += a
            total[ring] += a * high
            square[ring] += a * high * high
            for at in range(len(SECTIONS)):
                if high > SECTIONS[at]:
                    sections[at] += a
            if 1 <= ring <= 3:
                dx, dy = level[k, 0] - x, level[k, 1] - y
                far = dx * dx + dy * dy
                if far > 0:
                    near = np.sqrt(far)
                    once_c += a * high * dx / near
                    once_s += a * high * dy / near
                    twice_c += a * high * (dx * dx - dy * dy) / far
                    twice_s += a * high * 2 * dx * dy / far
                ring_area += a
            if distance[v, u] == most:
                circle = max(circle, a)
            k += 1

    out = np.empty(COUNT)
    out[0] = 1e3 * most * np.sqrt(circle)
    out[1], out[2] = 2e3 * major_m, 2e3 * minor_m
    inner = 0.5
    for ring in range(rings - 1, -1, -1):
        # A ring too narrow for a pixel is as high as the one inside it.
        inner = total[ring] / share[ring] if share[ring] > 0 else inner
        out[3 + ring] = inner
        if ring < UNEVEN_RINGS:
            spread = square[ring] / share[ring] - inner * inner if share[ring] > 0 else 0.0
            out[3 + rings + ring] = np.sqrt(max(spread, 0.0))
    at = 3 + rings + UNEVEN_RINGS
    for section in range(len(SECTIONS)):
        out[at + section] = 1e4 * sections[section]
    floor, cap = out[3] * height_m, 0.0
    for k in range(n):
        cap += areas_m2[k] * max(heights[k] - floor, 0.0)
    out[at + 3] = 1e6 * cap
    out[at + 4] = np.sqrt(once_c * once_c + once_s * once_s) / ring_area if ring_area > 0 else 0.0
    out[at + 5] = np.sqrt(twice_c * twice_c + twice_s * twice_s) / ring_area if ring_area > 0 else 0.0
    return out
