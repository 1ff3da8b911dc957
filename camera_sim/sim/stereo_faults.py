"""What real stereo cameras do beyond noise: islands of mismatch, lost outlines and skin, a bowed field of view."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

Field = NDArray[np.float32]
JUMP_PX = 0.4
"""Disparity between two neighbours from which on they lie on two sides of an outline."""
WIDTH_SPREAD = 0.6
"""Standard deviation of the logarithm of a hole's width along an outline."""
WIDEST_PX = 40.0
ISLAND_RADIUS_PX = (1.5, 12.0)


def add_islands(d: Field, *, per_megapixel: float, offset_px: tuple[float, float], rng: Generator) -> None:
    """Shift round spots of the disparity image by `offset_px` (smallest, largest) either way, as false matches are."""
    height, width = d.shape
    for _ in range(int(rng.poisson(per_megapixel * height * width / 1e6))):
        v, u = rng.uniform(0, height), rng.uniform(0, width)
        radius = np.exp(rng.uniform(*np.log(ISLAND_RADIUS_PX)))
        offset = np.exp(rng.uniform(*np.log(offset_px))) * (1 if rng.random() < 0.5 else -1)
        v0, u0 = max(0, int(v - radius)), max(0, int(u - radius))
        part = d[v0 : int(v + radius) + 2, u0 : int(u + radius) + 2]
        rows, columns = np.ogrid[v0 : v0 + part.shape[0], u0 : u0 + part.shape[1]]
        part[(rows - v) ** 2 + (columns - u) ** 2 <= radius**2] += np.float32(offset)


def lost_outlines(true: Field, wander: Field, *, near_px: float, far_px: float) -> NDArray[np.bool_]:
    """(h, w) where an outline takes the depth of what is beside it, on all its sides.

    Args:
        true: (h, w) true disparity, pixels.
        wander: (h, w) smooth noise of unit variance: widths change along an outline.
        near_px: median width lost on the nearer surface's side; far_px: on the farther one's.
    """
    near, far = _outlines(true)
    if not near.any():
        return np.zeros(true.shape, np.bool_)
    to_near, to_far = _distance(near), _distance(far)
    spread = np.exp(np.float32(WIDTH_SPREAD) * wander)
    on_near = (to_near <= to_far) & (to_near < np.float32(near_px) * spread - np.float32(0.5))
    on_far = (to_far < to_near) & (to_far < np.minimum(np.float32(far_px) * spread, np.float32(WIDEST_PX)) - 0.5)
    return np.asarray(on_near | on_far)


def bowed_field(rng: Generator, *, height: int, width: int) -> Field:
    """(h, w) float32, unit variance, no mean and no tilt: a bowl, a saddle and waves of 100 px and more."""
    v, u = (np.linspace(-1, 1, n, dtype=np.float32) for n in (height, width))
    rows, columns = max(6, height // 50), max(6, width // 50)
    waves = cv2.GaussianBlur(rng.standard_normal((rows, columns), dtype=np.float32), (0, 0), 1.5)
    waves = cv2.resize(waves / waves.std(), (width, height), interpolation=cv2.INTER_CUBIC)
    bowl = rng.standard_normal(3).astype(np.float32)
    field = waves + bowl[0] * v[:, None] ** 2 + bowl[1] * u[None, :] ** 2 + bowl[2] * v[:, None] * u[None, :]
    field -= field.mean()
    for axis in (v[:, None], u[None, :]):
        field -= axis * ((field * axis).mean() / (axis * axis).mean())
    return _as_field(field / field.std())


def _outlines(true: Field) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """(near, far): pixels that stand out from a neighbour by a jump, and those neighbours."""
    near, far = np.zeros(true.shape, np.bool_), np.zeros(true.shape, np.bool_)
    for before, after in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):
        step = true[after] - true[before]
        rises, falls = step > JUMP_PX, step < -JUMP_PX
        near[after] |= rises
        far[before] |= rises
        near[before] |= falls
        far[after] |= falls
    return near, far


def _distance(edge: NDArray[np.bool_]) -> Field:
    return _as_field(cv2.distanceTransform((~edge).astype(np.uint8), cv2.DIST_L2, 3))


def _as_field(array: Any) -> Field:
    return np.asarray(array, np.float32)
