"""The square-mesh size of a body: the side of the smallest square hole that it passes, turned as it likes.

A body passes a square hole of side s along a direction when its shadow along that direction fits into the square. The
shadow fits when its extents along two directions at right angles in the hole's plane are at most s. So the size is the
least, over all pairs of orthogonal unit vectors (u, v), of the larger of the two widths w(u) and w(v), where w(n) is
the body's extent along n: the direction of passing is u x v, and only the convex hull matters.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from camera_sim.sim.meshes import Vertices, icosphere

LEVEL = 2
"""Of the sphere of directions of passing: 162, some 15 degrees apart."""
TURNS = 12
"""Turns of the hole about each of them, over a quarter turn: 7.5 degrees apart."""
STARTS = 8
STEP_RAD, LEAST_STEP_RAD = 0.12, 2e-4
"""A start is refined by turns about its three axes, halved down to the least: 0.01 mm on a tuber."""


def square_mesh_m(vertices: Vertices) -> float:
    """Side of the smallest square hole that the body of these vertices (V, 3) passes, in their unit.

    Searched over all directions, then refined from the best ones: never below the true size, and above it by less than
    0.1 % on tubers (`tests/camera_sim/test_camera_sim_mesh_size.py`).
    """
    hull = vertices[ConvexHull(vertices).vertices]
    frames = _coarse(hull)
    return min(_refined(hull, frame) for frame in frames)


def widths(hull: Vertices, directions: Vertices) -> NDArray[np.float64]:
    """(n,) extent of the body along (n, 3) unit vectors."""
    along = directions @ hull.T
    return np.asarray(along.max(axis=1) - along.min(axis=1))


def _coarse(hull: Vertices) -> list[Vertices]:
    """The best (3, 3) frames, rows u, v and the direction of passing, from different directions of passing."""
    through = icosphere(LEVEL)[0]
    through = through[through[:, 2] >= 0]
    other = np.where(np.abs(through[:, :1]) < 0.9, np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 1.0, 0.0]]))
    first = np.cross(through, other)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(through, first)
    angle = np.arange(2 * TURNS) * (np.pi / (2 * TURNS))
    turned = first[:, None] * np.cos(angle)[:, None] + second[:, None] * np.sin(angle)[:, None]
    across = widths(hull, turned.reshape(-1, 3)).reshape(len(through), 2 * TURNS)
    # Half a turn has 2 TURNS directions; TURNS further on lies the one at right angles.
    side = np.maximum(across[:, :TURNS], across[:, TURNS:])
    best = side.argmin(axis=1)
    order = np.argsort(side[np.arange(len(through)), best], kind="stable")[:STARTS]
    return [np.array([turned[i, best[i]], turned[i, best[i] + TURNS], through[i]]) for i in order.tolist()]


def _refined(hull: Vertices, frame: Vertices) -> float:
    """The least side near `frame`: turned about each of its axes both ways, by ever smaller angles."""
    here = float(widths(hull, frame[:2]).max())
    step = STEP_RAD
    while step > LEAST_STEP_RAD:
        tried = _turns(step) @ frame
        side = widths(hull, tried[:, :2].reshape(-1, 3)).reshape(-1, 2).max(axis=1)
        best = int(side.argmin())
        if side[best] < here:
            here, frame = float(side[best]), tried[best]
        else:
            step /= 2
    return here


@cache
def _turns(angle: float) -> NDArray[np.float64]:
    """(26, 3, 3) rotations by `angle` about every sum of the three axes and their opposites."""
    steps = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z], float)
    axes = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    k = np.zeros((len(axes), 3, 3))
    k[:, 0, 1], k[:, 0, 2], k[:, 1, 2] = -axes[:, 2], axes[:, 1], -axes[:, 0]
    k -= k.transpose(0, 2, 1)
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k))
