"""A tuber completed from the side that is seen: what is hidden is taken to mirror what is visible.

The middle of a body at rest lies half its height above the resting level, under the middle of its outline. Mirrored at
that point the visible side shows the hidden one: exactly so for an ellipsoid in any pose, seen from far. Of the hull of
both, caliper axes and square-mesh size are read as of a whole tuber. What rim the camera lost is lost on both sides.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
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
    points = level[:: max(1, len(level) // MOST_POINTS)].copy()
    middle_z = distance_m - height_m / 2
    # The outline's middle leans outwards under a camera, the middle of the body does not (segmenter/frame/place.py).
    middle = (points[:, :2] / points[:, 2:]).mean(axis=0) * middle_z * (1 - (height_m / 2 / middle_z) ** 2)
    high = distance_m - points[:, 2] > LEAST_HEIGHT * height_m
    points = points[high] - np.array([middle[0], middle[1], middle_z])
    directions, frames = _directions()
    along = points @ directions.T
    extremes = np.unique(np.concatenate([along.argmax(axis=0), along.argmin(axis=0)]))
    hull = points[extremes]
    reach = 2000 * np.abs(hull @ directions.T).max(axis=0)
    longest = int(reach.argmax())
    around = _around(directions[longest])
    across = 2000 * np.abs(hull @ around.T).max(axis=0)
    thinnest = int(across.argmin())
    widest = (thinnest + len(around) // 2) % len(around)
    mesh = _mesh_mm(hull, frames)
    return float(reach[longest]), float(across[widest]), float(across[thinnest]), mesh


def _mesh_mm(hull: NDArray[np.float64], frames: NDArray[np.float64]) -> float:
    """The least square hole over all `frames` (n, 2, 3), then refined about the best of them."""
    side = 2000 * np.abs(hull @ frames.reshape(-1, 3).T).max(axis=0).reshape(-1, 2).max(axis=1)
    best = int(side.argmin())
    here, u, v = float(side[best]), frames[best, 0], frames[best, 1]
    for step in STEPS_RAD:
        tried = _turned(u, v, step)
        side = 2000 * np.abs(hull @ tried.reshape(-1, 3).T).max(axis=0).reshape(-1, 2).max(axis=1)
        best = int(side.argmin())
        if side[best] < here:
            here, u, v = float(side[best]), tried[best, 0], tried[best, 1]
    return here


def _turned(u: NDArray[np.float64], v: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    """(26, 2, 3) the pair (u, v) turned by about `step` about every sum of its axes and their opposites."""
    w = np.cross(u, v)
    a, b, c = (step * n.ravel() for n in np.meshgrid(*[(-1.0, 0.0, 1.0)] * 3))
    first = u + c[:, None] * v - b[:, None] * w
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = v - c[:, None] * u + a[:, None] * w
    second -= (second * first).sum(axis=1, keepdims=True) * first
    second /= np.linalg.norm(second, axis=1, keepdims=True)
    return np.stack([first, second], axis=1)


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
