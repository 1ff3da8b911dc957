"""What a mask leaves out: holes inside it are filled, strays cut off, and a cloud without an image gets one.

Cameras lose blobs of a tuber's skin, and false matches put islands of it elsewhere. The volume under a hole belongs to
the tuber: its depth is interpolated from what surrounds it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel

BESIDE_M = 0.005
"""A part of a tuber that a hole cuts off lies within its depth range, give or take this; a false match does not."""
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


@kernel(nogil=True)
def drop_islands(depth: NDArray[np.uint16], step: int, beside: int) -> int:
    """Zero, in place, every part of `depth` (h, w) that lies off the depth range of its largest part; pixels dropped.

    Parts are connected where 4-neighbours differ by less than `step` units; a part is off when its mean depth lies more
    than `beside` units outside the largest part's range.
    """
    rows, columns = depth.shape
    label = np.zeros((rows, columns), np.int32)
    stack = np.empty(rows * columns, np.int32)
    sizes, sums, lows, highs = [0], [0.0], [np.int64(0)], [np.int64(0)]
    for first in range(rows * columns):
        if depth.flat[first] == 0 or label.flat[first] != 0:
            continue
        name = len(sizes)
        size, total, low, high = 0, 0.0, np.int64(65535), np.int64(0)
        stack[0] = first
        top = 1
        label.flat[first] = name
        while top > 0:
            top -= 1
            v, u = stack[top] // columns, stack[top] % columns
            here = np.int64(depth[v, u])
            size += 1
            total += here
            low, high = min(low, here), max(high, here)
            for dv, du in ((-1, 0), (1, 0), (0, -1), (0, 1)):
                b, a = v + dv, u + du
                if b < 0 or a < 0 or b >= rows or a >= columns or depth[b, a] == 0 or label[b, a] != 0:
                    continue
                if abs(np.int64(depth[b, a]) - here) < step:
                    label[b, a] = name
                    stack[top] = b * columns + a
                    top += 1
        sizes.append(size)
        sums.append(total)
        lows.append(low)
        highs.append(high)
    if len(sizes) < 3:
        return 0
    main = 1
    for name in range(2, len(sizes)):
        if sizes[name] > sizes[main]:
            main = name
    dropped = 0
    for name in range(1, len(sizes)):
        mean = sums[name] / sizes[name]
        if name != main and (mean < lows[main] - beside or mean > highs[main] + beside):
            dropped += sizes[name]
            sizes[name] = -1
    if dropped:
        for i in range(rows * columns):
            if label.flat[i] != 0 and sizes[label.flat[i]] < 0:
                depth.flat[i] = 0
    return dropped


@kernel(nogil=True)
def fill_holes(depth: NDArray[np.float64]) -> int:
    """Fill, in place, every empty pixel of `depth` (h, w) that is enclosed; how many there were.

    A filled pixel has the mean of the linear interpolations along its row and its column, each weighted by how narrow
    the hole is there: exact on a plane.
    """
    rows, columns = depth.shape
    outside, stack, top = np.zeros((rows, columns), np.bool_), np.empty(rows * columns, np.int32), 0
    for v in range(rows):
        for u in range(0, columns, 1 if v in (0, rows - 1) else max(columns - 1, 1)):
            if depth[v, u] == 0:
                outside[v, u] = True
                stack[top] = v * columns + u
                top += 1
    while top > 0:
        top -= 1
        v, u = stack[top] // columns, stack[top] % columns
        for dv, du in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            b, a = v + dv, u + du
            if 0 <= b < rows and 0 <= a < columns and depth[b, a] == 0 and not outside[b, a]:
                outside[b, a] = True
                stack[top] = b * columns + a
                top += 1
    holed_rows, holed_columns, holes = np.zeros(rows, np.bool_), np.zeros(columns, np.bool_), False
    for v in range(rows):
        for u in range(columns):
            if depth[v, u] == 0 and not outside[v, u]:
                holed_rows[v] = holed_columns[u] = holes = True
    if not holes:
        return 0
    total, weight = np.zeros((rows, columns)), np.zeros((rows, columns))
    for v in range(rows):
        if not holed_rows[v]:
            continue
        last = -1
        for u in range(columns):
            if depth[v, u] > 0:
                if last >= 0 and u - last > 1 and not outside[v, last + 1]:
                    for i in range(last + 1, u):
                        w = 1.0 / (u - last)
                        total[v, i] += w * (depth[v, last] * (u - i) + depth[v, u] * (i - last)) / (u - last)
                        weight[v, i] += w
                last = u
            elif outside[v, u]:
                last = -1
    for u in range(columns):
        if not holed_columns[u]:
            continue
        last = -1
        for v in range(rows):
            if depth[v, u] > 0:
                if last >= 0 and v - last > 1 and not outside[last + 1, u]:
                    for i in range(last + 1, v):
                        w = 1.0 / (v - last)
                        total[i, u] += w * (depth[last, u] * (v - i) + depth[v, u] * (i - last)) / (v - last)
                        weight[i, u] += w
                last = v
            elif outside[v, u]:
                last = -1
    filled = 0
    for v in range(rows):
        for u in range(columns):
            if depth[v, u] == 0 and not outside[v, u] and weight[v, u] > 0:
                depth[v, u] = total[v, u] / weight[v, u]
                filled += 1
    return filled
