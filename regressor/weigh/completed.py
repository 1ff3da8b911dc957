"""A tuber completed from the side that is seen: what is hidden is taken to mirror what is visible.

The middle of a body at rest lies half its height above the resting level, under the middle of its outline. Mirrored at
that point the visible side shows the hidden one: exactly so for an ellipsoid in any pose, seen from far. Of the hull of
both, caliper axes and square-mesh size are read as of a whole tuber. What rim the camera lost is lost on both sides.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel

NAMES = ("completed_length_mm", "completed_width_mm", "completed_thickness_mm", "completed_mesh_mm")
MOST_POINTS = 2500
LEAST_HEIGHT = 0.4
"""Of the height: what is lower is left out, for cameras smear the rim down to the belt, and mirrored it would stand out
at the top. Of the true rim little lies so low (0.3 and 0.5 scatter as much on training belts)."""
RINGS, HOLE_RINGS = 9, 6
"""Directions on a half sphere lie on so many rings, 11 degrees apart for widths, 18 for directions of passing."""
TURNS = 9
"""Turns of the square hole about a direction of passing, over a quarter turn."""
STEPS_RAD = (0.10, 0.05, 0.025, 0.012)
"""Turns by which the best hole is refined."""


def completed_sizes_mm(
    level: NDArray[np.float64], *, distance_m: float, height_m: float
) -> tuple[float, float, float, float]:
    """(length, width, thickness, square mesh) of the completed body, millimetres.

    Args:
        level: (N, 3) metres, level frame (z away from the camera), of the visible surface, evenly over the image.
        distance_m: of the optical centre above the resting level. height_m: of the top above that level.
    """
    points = _about_middle(level[:: max(1, len(level) // MOST_POINTS)], distance_m, height_m)
    directions, frames = _directions()
    hull = points[_extremes(points, directions)]
    reach = _reach_mm(hull, directions)
    longest = int(reach.argmax())
    across = _reach_mm(hull, _around_direction(longest))
    thinnest = int(across.argmin())
    widest = (thinnest + len(across) // 2) % len(across)
    return float(reach[longest]), float(across[widest]), float(across[thinnest]), _mesh_mm(hull, frames)


@kernel(nogil=True)
def _about_middle(points: NDArray[np.float64], distance_m: float, height_m: float) -> NDArray[np.float64]:
    """(m, 3) those of (n, 3) points that lie high enough, from the middle of the body."""
    count = len(points)
    x, y, high = 0.0, 0.0, 0
    for n in range(count):
        x += points[n, 0] / points[n, 2]
        y += points[n, 1] / points[n, 2]
        high += distance_m - points[n, 2] > LEAST_HEIGHT * height_m
    # The outline's middle leans outwards under a camera, the middle of the body does not (segmenter/frame/place.py).
    z = distance_m - height_m / 2
    out = z * (1 - (height_m / 2 / z) ** 2) / count
    found, m = np.empty((high, 3)), 0
    for n in range(count):
        if distance_m - points[n, 2] > LEAST_HEIGHT * height_m:
            found[m, 0], found[m, 1], found[m, 2] = points[n, 0] - x * out, points[n, 1] - y * out, points[n, 2] - z
            m += 1
    return found


def _mesh_mm(hull: NDArray[np.float64], frames: NDArray[np.float64]) -> float:
    """The least square hole over all `frames` (3, 2 n), one side beside the other, then refined about the best."""
    best, here = _least_hole_mm(hull, frames)
    u, v = frames[:, 2 * best], frames[:, 2 * best + 1]
    for step in STEPS_RAD:
        tried = _turned(u, v, step)
        best, side = _least_hole_mm(hull, tried)
        if side < here:
            here, u, v = side, tried[:, 2 * best], tried[:, 2 * best + 1]
    return here


def _least_hole_mm(hull: NDArray[np.float64], frames: NDArray[np.float64]) -> tuple[int, float]:
    side = _reach_mm(hull, frames).reshape(-1, 2).max(axis=1)
    best = int(side.argmin())
    return best, float(side[best])


@kernel(nogil=True)
def _turned(u: NDArray[np.float64], v: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    """(3, 2 * 27) the pair (u, v) as it is, and turned by about `step` about sums of its axes and their opposites."""
    w = np.array([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])
    turned = np.empty((3, 54))
    for n in range(27):
        b, a, c = (n // 9 - 1) * step, (n // 3 % 3 - 1) * step, (n % 3 - 1) * step
        first = u + c * v - b * w
        first /= np.sqrt(first[0] * first[0] + first[1] * first[1] + first[2] * first[2])
        second = v - c * u + a * w
        second -= (second[0] * first[0] + second[1] * first[1] + second[2] * first[2]) * first
        second /= np.sqrt(second[0] * second[0] + second[1] * second[1] + second[2] * second[2])
        turned[:, 2 * n], turned[:, 2 * n + 1] = first, second
    return turned


@kernel(nogil=True, fastmath={"contract"})
def _extremes(points: NDArray[np.float64], directions: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(n,) which of (n, 3) points lie first highest or lowest along any of (3, m) directions.

    Point after point, all directions at once, and no (n, m) places are written down: they would not fit the cache.
    """
    many = directions.shape[1]
    x, y, z = directions[0], directions[1], directions[2]
    highest, lowest = np.full(many, -np.inf), np.full(many, np.inf)
    last, first = np.zeros(many, np.int64), np.zeros(many, np.int64)
    for n in range(len(points)):
        a, b, c = points[n, 0], points[n, 1], points[n, 2]
        for k in range(many):
            value = c * z[k] + (b * y[k] + a * x[k])  # contracted and rounded as in a matrix product
            last[k] = n if value > highest[k] else last[k]
            highest[k] = value if value > highest[k] else highest[k]
            first[k] = n if value < lowest[k] else first[k]
            lowest[k] = value if value < lowest[k] else lowest[k]
    extreme = np.zeros(len(points), np.bool_)
    extreme[last] = extreme[first] = True
    return extreme


@kernel(nogil=True, fastmath={"contract"})
def _reach_mm(points: NDArray[np.float64], directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """(m,) millimetres across the body along (3, m) directions, from (n, 3) points about its middle, metres."""
    many = directions.shape[1]
    x, y, z = directions[0], directions[1], directions[2]
    reach = np.zeros(many)
    for n in range(len(points)):
        a, b, c = points[n, 0], points[n, 1], points[n, 2]
        for k in range(many):
            away = abs(c * z[k] + (b * y[k] + a * x[k]))
            reach[k] = away if away > reach[k] else reach[k]
    return 2000 * reach


@lru_cache
def _around_direction(index: int) -> NDArray[np.float64]:
    """(3, 36) `_around` one of the `_directions`."""
    return np.ascontiguousarray(_around(_directions()[0][:, index]).T)


def _around(axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """(36, 3) directions at right angles to `axis`, over half a turn."""
    other = np.array([0.0, 0.0, 1.0]) if abs(axis[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    u = np.cross(axis, other)
    u /= np.linalg.norm(u)
    v = np.cross(axis, u)
    angle = np.arange(36) * (np.pi / 36)
    return np.asarray(np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v)


@lru_cache(maxsize=1)
def _directions() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(3, n) directions on a half sphere, and (3, 2 k) pairs of sides of square holes, some 18 degrees apart."""
    sides: list[NDArray[np.float64]] = []
    for axis in _half_sphere(HOLE_RINGS):
        side = _around(axis)[:: 36 // (2 * TURNS)]
        for k in range(TURNS):
            sides += [side[k], side[k + TURNS]]
    return np.ascontiguousarray(_half_sphere(RINGS).T), np.ascontiguousarray(np.array(sides).T)


def _half_sphere(rings: int) -> NDArray[np.float64]:
    """(n, 3) unit vectors on rings from the pole to the equator, as far apart on a ring as the rings are."""
    found = [(0.0, 0.0, 1.0)]
    for ring in range(1, rings):
        polar = np.pi / 2 * ring / (rings - 1)
        count = 2 * max(3, round(2 * (rings - 1) * np.sin(polar)))
        # On the equator opposite directions are the same.
        for turn in range(count // 2 if ring == rings - 1 else count):
            angle = 2 * np.pi * turn / count
            found.append((np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), np.cos(polar)))
    return np.array(found)
