"""A cloud that came without an image gets one, of about four points a pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

POINTS_PER_CELL = 4.0
MOST_CELLS = 2048
"""Cells along a side of such an image: points far beside the cloud make them larger, not more."""
FINE_CELLS = 24.0
"""Points per cell of the coarse grid that the cloud's density is measured with."""


@dataclass(frozen=True, slots=True)
class AngleImage:
    """A cloud as an image over x / z and y / z.

    Attributes:
        depth_m: (h, w) float64 mean depth of each cell's points, 0 where it has none.
        share: (h, w) how much of a cell the cloud covers: below 1 at its rim only.
        pixel: size of a cell, the tangent of its angle; x0, y0: of the first cell's middle.
    """

    depth_m: NDArray[np.float64]
    share: NDArray[np.float64]
    pixel: float
    x0: float
    y0: float


def angle_image(points: NDArray[np.float64]) -> AngleImage:
    """The image of a cloud whose pixels are unknown, about four points per cell.

    Args:
        points: (N, 3), level frame, metres, z > 0.
    """
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    span = max(float(np.ptp(x)), float(np.ptp(y)))
    pixel = max(float(np.sqrt(POINTS_PER_CELL / _density(x, y))), span / MOST_CELLS)
    x0, y0 = float(x.min()), float(y.min())
    column, row = ((x - x0) / pixel).astype(np.int64), ((y - y0) / pixel).astype(np.int64)
    shape = int(row.max()) + 1, int(column.max()) + 1
    flat = row * shape[1] + column
    count = np.bincount(flat, minlength=shape[0] * shape[1]).reshape(shape).astype(np.float64)
    total = np.bincount(flat, points[:, 2], minlength=shape[0] * shape[1]).reshape(shape)
    depth_m = np.divide(total, count, out=np.zeros(shape), where=count > 0)
    share = np.where(_inside(count > 0), 1.0, np.minimum(count / POINTS_PER_CELL, 1.0))
    return AngleImage(depth_m, share, pixel, x0 + pixel / 2, y0 + pixel / 2)


def _density(x: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """Points per unit of the plane, measured in cells that lie wholly inside the cloud, over four shifted grids."""
    wide, high = float(np.ptp(x)), float(np.ptp(y))
    area = max(wide * high, 1e-12)
    size = max(np.sqrt(FINE_CELLS * area / len(x)), max(wide, high) / MOST_CELLS)
    found = []
    for shift in (0.0, 0.25, 0.5, 0.75):
        column = np.floor((x - x.min()) / size + shift).astype(np.int64)
        row = np.floor((y - y.min()) / size + shift).astype(np.int64)
        shape = int(row.max()) + 1, int(column.max()) + 1
        count = np.bincount(row * shape[1] + column, minlength=shape[0] * shape[1]).reshape(shape)
        inside = _inside(count > 0)
        if inside.any():
            found.append(float(count[inside].sum()) / (inside.sum() * size * size))
    return float(np.mean(found)) if found else len(x) / area


def _inside(full: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Cells all of whose eight neighbours are full as well."""
    padded = np.pad(full, 1)
    rows, columns = full.shape
    out = full.copy()
    for dv in range(3):
        for du in range(3):
            out &= padded[dv : dv + rows, du : du + columns]
    return out
