"""Farthest-point sampling and the neighbour rule, on the CPU, exact and with written tie rules.

Both follow torch_cluster's CUDA kernels, which PointRAFT's published checkpoint was trained with: a neighbour list is
the *first* 64 points in index order inside the radius (strict <), not the nearest ones and not random ones. Where the
CUDA code leaves ties to the layout of threads, the lowest index wins here.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel

LANES = 64


def farthest_points(points: NDArray[np.float32], count: int, *, start: int = 0) -> NDArray[np.int64]:
    """Greedy farthest-point sampling.

    Args:
        points: (N, 3) float32, any frame, metres.
        count: how many to pick, 1..N.
        start: index of the first pick.

    Returns:
        (count,) int64 indices in the order of selection; the lowest index wins among equal distances.
    """
    if not 1 <= count <= len(points):
        raise ValueError(f"cannot pick {count} of {len(points)} points")
    if not 0 <= start < len(points):
        raise ValueError(f"start {start} is outside 0..{len(points) - 1}")
    padded = -(-len(points) // LANES) * LANES
    columns = np.zeros((3, padded), np.float32)
    columns[:, : len(points)] = points.T
    return _farthest(columns, len(points), count, start)


@kernel(nogil=True)
def _farthest(columns: NDArray[np.float32], n: int, count: int, start: int) -> NDArray[np.int64]:
    # 64 running maxima side by side: LLVM vectorises the lanes, which it cannot do for one argmax.
    padded = columns.shape[1]
    x, y, z = columns[0], columns[1], columns[2]
    near = np.full(padded, np.float32(np.inf), np.float32)
    near[n:] = np.float32(-1.0)
    best = np.empty(LANES, np.float32)
    block_of = np.empty(LANES, np.int32)
    chosen = np.empty(count, np.int64)
    last = start
    chosen[0] = start
    for pick in range(1, count):
        px, py, pz = x[last], y[last], z[last]
        best[:] = np.float32(-2.0)
        block_of[:] = 0
        for block in range(padded // LANES):
            offset = block * LANES
            for lane in range(LANES):
                i = offset + lane
                dx = x[i] - px
                dy = y[i] - py
                dz = z[i] - pz
                distance = dx * dx + dy * dy + dz * dz
                kept = near[i]
                kept = distance if distance < kept else kept
                near[i] = kept
                larger = kept > best[lane]
                best[lane] = kept if larger else best[lane]
                block_of[lane] = np.int32(block) if larger else block_of[lane]
        top = best[0]
        for lane in range(1, LANES):
            top = max(top, best[lane])
        last = padded
        for lane in range(LANES):
            if best[lane] == top:
                last = min(last, block_of[lane] * LANES + lane)
        chosen[pick] = last
    return chosen


@kernel(nogil=True)
def first_in_range(
    points: NDArray[np.float32], centroids: NDArray[np.float32], radius: float, limit: int
) -> NDArray[np.int64]:
    """The first `limit` points in index order closer than `radius` to each centroid.

    Args:
        points: (N, 3) float32, metres. centroids: (M, 3) float32, same frame.
        radius: metres; compared as float32(radius * radius), strictly.
        limit: neighbours kept per centroid.

    Returns:
        (M, limit) int64 indices into `points`, padded with -1.
    """
    limit_squared = np.float32(radius * radius)
    found = np.full((len(centroids), limit), -1, np.int64)
    for row in range(len(centroids)):
        count = 0
        for i in range(len(points)):
            dx = points[i, 0] - centroids[row, 0]
            dy = points[i, 1] - centroids[row, 1]
            dz = points[i, 2] - centroids[row, 2]
            if dx * dx + dy * dy + dz * dz < limit_squared:
                found[row, count] = i
                count += 1
                if count == limit:
                    break
    return found
