"""A tuber completed from the side that is seen: what is hidden is taken to mirror what is visible.

The middle of a body at rest lies half its height above the resting level, under the middle of its outline. Mirrored at
that point the visible side shows the hidden one: exactly so for an ellipsoid in any pose, seen from far. Of the hull of
both, caliper axes and square-mesh size are read as of a whole tuber. What rim the camera lost is lost on both sides.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

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
    points = level[:: max(1, len(level) // MOST_POINTS)]
    middle_z = distance_m - height_m / 2
    # The outline's middle leans outwards under a camera, the middle of the body does not (segmenter/frame/place.py).
    middle = (points[:, :2] / points[:, 2:]).mean(axis=0) * middle_z * (1 - (height_m / 2 / middle_z) ** 2)
    high = distance_m - points[:, 2] > LEAST_HEIGHT * height_m
    points = points[high] - np.array([middle[0], middle[1], middle_z])
    directions, frames = _directions()
    hull = points[_extremes(points, np.ascontiguousarray(directions.T))]
    reach = _reach_mm(hull @ directions.T)
    longest = int(reach.argmax())
    around = _around_direction(longest)
    across = _reach_mm(hull @ around.T)
    thinnest = int(across.argmin())
    widest = (thinnest + len(around) // 2) % len(around)
    mesh = _mesh_mm(hull, frames)
    return float(reach[longest]), float(across[widest]), float(across[thinnest]), mesh


def _mesh_mm(hull: NDArray[np.float64], frames: NDArray[np.float64]) -> float:
    """The least square hole over all `frames` (n, 2, 3), then refined about the best of them."""
    side = _reach_mm(hull @ frames.reshape(-1, 3).T).reshape(-1, 2).max(axis=1)
    best = int(side.argmin())
    here, u, v = float(side[best]), frames[best, 0], frames[best, 1]
    for step in STEPS_RAD:
        tried = _turned(u, v, step)
        side = _reach_mm(hull @ tried.reshape(-1, 3).T).reshape(-1, 2).max(axis=1)
        best = int(side.argmin())
        if side[best] < here:
            here, u, v = float(side[best]), tried[best, 0], tried[best, 1]
    return here


@njit(cache=True, nogil=True)
def _turned(u: NDArray[np.float64], v: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    """(27, 2, 3) the pair (u, v) as it is, and turned by about `step` about sums of its axes and their opposites."""
    w = np.array([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])
    turned = np.empty((27, 2, 3))
    for n in range(27):
        b, a, c = (n // 9 - 1) * step, (n // 3 % 3 - 1) * step, (n % 3 - 1) * step
        first = u + c * v - b * w
        first /= np.sqrt(first[0] * first[0] + first[1] * first[1] + first[2] * first[2])
        second = v - c * u + a * w
        second -= (second[0] * first[0] + second[1] * first[1] + second[2] * first[2]) * first
        second /= np.sqrt(second[0] * second[0] + second[1] * second[1] + second[2] * second[2])
        turned[n, 0], turned[n, 1] = first, second
    return turned


@njit(cache=True, nogil=True, fastmath={"contract"})
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


@njit(cache=True, nogil=True)
def _reach_mm(along: NDArray[np.float64]) -> NDArray[np.float64]:
    """(m,) millimetres across the body along m directions, from the (n, m) places of its points, metres."""
    reach = np.zeros(along.shape[1])
    for n in range(len(along)):
        for k in range(along.shape[1]):
            away = abs(along[n, k])
            reach[k] = away if away > reach[k] else reach[k]
    return 2000 * reach


@lru_cache
def _around_direction(index: int) -> NDArray[np.float64]:
    """`_around` one of the `_directions`."""
    return _around(_directions()[0][index])


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
    """(n, 3) directions on a half sphere, and (k, 2, 3) the sides of square holes, some 18 degrees apart."""
    frames = []
    for axis in _half_sphere(HOLE_RINGS):
        side = _around(axis)[:: 36 // (2 * TURNS)]
        frames += [(side[k], side[k + TURNS]) for k in range(TURNS)]
    return _half_sphere(RINGS), np.array(frames)


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
