"""Where a real tuber lay: its complete cloud registered to what one frame saw of it, from many starts.

R9-9 of 3DPotatoTwin is the one tuber at hand with both. Its complete cloud (structure from motion) in the place of the
partial one (the camera's frame) shows the underside that no camera saw, and so how far it lay below the stated belt.
A tuber this round fits in many poses nearly as well: each optimum counts by how well it fits, and they all together
are the uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

STARTS = 150
ROUNDS = 60
USED_POINTS = 1500
TRIM = 0.95
"""Share of the points, best first, that a fit is made with."""
INDEPENDENT = 40.0
"""So many errors of a partial cloud are independent: stereo's are alike over 10 to 20 pixels, masks have 11,000."""
NORMAL_POINTS = 24


@dataclass(frozen=True, slots=True)
class Optimum:
    """One start's end. `lowest_m`: the tuber's farthest point from the camera along its axis; `rms_m` of the fit."""

    lowest_m: float
    rms_m: float


@dataclass(frozen=True, slots=True)
class RestingFit:
    """The offset below the stated belt and its standard deviation, metres, from all `optima`, best first."""

    offset_m: float
    sd_m: float
    optima: tuple[Optimum, ...]


def measure_resting(
    partial: NDArray[np.float64],
    complete: NDArray[np.float64],
    *,
    belt_distance_m: float,
    starts: int = STARTS,
    seed: int = 0,
) -> RestingFit:
    """How far the underside of `complete` lies below the belt, registered to `partial`.

    Args:
        partial: (N, 3) metres, the camera's frame. complete: (M, 3) metres, any frame, all round.
        belt_distance_m: from the camera to the stated belt along its axis.
    """
    rng = np.random.default_rng(seed)
    used = partial[rng.choice(len(partial), min(USED_POINTS, len(partial)), replace=False)]
    body = complete - complete.mean(0)
    tree, normals = cKDTree(body), _normals(body)
    optima = [_register(used, body, tree, normals, rotation) for rotation in Rotation.random(starts, rng=rng)]
    optima.sort(key=lambda found: found.rms_m)
    rms_m = np.array([found.rms_m for found in optima])
    lowest_m = np.array([found.lowest_m for found in optima])
    weight = np.exp(-INDEPENDENT / 2 * ((rms_m / rms_m[0]) ** 2 - 1))
    offset_m = float(np.average(lowest_m, weights=weight)) - belt_distance_m
    spread_m2 = float(np.average((lowest_m - belt_distance_m - offset_m) ** 2, weights=weight))
    # The best fit's own error: a mean of so many independent ones.
    own_m2 = rms_m[0] ** 2 / INDEPENDENT
    return RestingFit(offset_m, float(np.sqrt(spread_m2 + own_m2)), tuple(optima))


def _register(
    seen: NDArray[np.float64],
    body: NDArray[np.float64],
    tree: cKDTree,
    normals: NDArray[np.float64],
    start: Rotation,
) -> Optimum:
    """Point-to-plane ICP of the seen points onto the body; the pose is body_from_camera."""
    rotation = start.as_matrix()
    # The camera sees the near side: the body's middle lies about a radius behind the points' mean.
    radius_m = float(np.cbrt(np.prod(np.ptp(body, axis=0)))) / 2
    shift = -rotation @ (seen.mean(0) + np.array([0.0, 0.0, 0.6 * radius_m]))
    rms_m = np.inf
    for _ in range(ROUNDS):
        placed = seen @ rotation.T + shift
        found = tree.query(placed)
        distance, nearest = np.asarray(found[0]), np.asarray(found[1])
        kept = distance <= np.quantile(distance, TRIM)
        point, normal = placed[kept], normals[nearest[kept]]
        off = ((body[nearest[kept]] - point) * normal).sum(1)
        design = np.hstack([np.cross(point, normal), normal])
        step = np.linalg.lstsq(design, off, rcond=None)[0]
        turn = Rotation.from_rotvec(step[:3]).as_matrix()
        rotation, shift = turn @ rotation, turn @ shift + step[3:]
        before, rms_m = rms_m, float(np.sqrt(np.mean(off**2)))
        if abs(before - rms_m) < 1e-8:
            break
    in_camera = (body - shift) @ rotation
    return Optimum(float(np.quantile(in_camera[:, 2], 0.9995)), rms_m)


def _normals(points: NDArray[np.float64]) -> NDArray[np.float64]:
    _, near = cKDTree(points).query(points, k=NORMAL_POINTS)
    around = points[near] - points[near].mean(1, keepdims=True)
    _, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))
    normals: NDArray[np.float64] = vectors[:, :, 0]
    return normals
