"""Farthest-point sampling and the neighbour rule, on the CPU, exact and with written tie rules.

Both follow torch_cluster's CUDA kernels, which PointRAFT's published checkpoint was trained with: a neighbour list is
the *first* 64 points in index order inside the radius (strict <), not the nearest ones and not random ones. Where the
CUDA code leaves ties to the layout of threads, the lowest index wins here.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel

LANES = 32
"""Points of a block."""
SAFE = np.float32(0.9999)
"""Of the squared distance to a block, so that no rounding makes it larger than that to one of its points."""


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
    # Points in the order of pixels lie together. So a pick changes few blocks: it is too far from the others for any of
    # their points. Within a block LLVM vectorises the lanes.
    padded = columns.shape[1]
    x, y, z = columns[0], columns[1], columns[2]
    near = np.full(padded, np.float32(np.inf), np.float32)
    near[n:] = np.float32(-1.0)
    low, high = _boxes(columns, n)
    blocks = padded // LANES
    farthest = np.full(blocks, np.float32(np.inf), np.float32)
    least = np.empty(blocks, np.float32)
    lanes = np.empty(LANES, np.float32)
    chosen = np.empty(count, np.int64)
    last = start
    chosen[0] = start
    for pick in range(1, count):
        px, py, pz = x[last], y[last], z[last]
        for block in range(blocks):
            dx = max(max(low[0, block] - px, px - high[0, block]), np.float32(0))
            dy = max(max(low[1, block] - py, py - high[1, block]), np.float32(0))
            dz = max(max(low[2, block] - pz, pz - high[2, block]), np.float32(0))
            least[block] = (dx * dx + dy * dy + dz * dz) * SAFE
        for block in range(blocks):
            if least[block] < farthest[block]:
                for lane in range(LANES):
                    i = block * LANES + lane
                    dx = x[i] - px
                    dy = y[i] - py
                    dz = z[i] - pz
                    distance = dx * dx + dy * dy + dz * dz
                    kept = near[i]
                    kept = distance if distance < kept else kept
                    near[i] = kept
                    lanes[lane] = kept
                half = LANES // 2
                while half > 0:
                    for lane in range(half):
                        lanes[lane] = max(lanes[lane], lanes[lane + half])
                    half //= 2
                farthest[block] = lanes[0]
        top = 0
        for block in range(1, blocks):
            top = block if farthest[block] > farthest[top] else top
        last = top * LANES
        while near[last] != farthest[top]:
            last += 1
        chosen[pick] = last
    return chosen


@kernel(nogil=True)
def _boxes(columns: NDArray[np.float32], n: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(3, B) lowest and highest coordinate of each block's points; what is behind the first `n` of them is none."""
    blocks = columns.shape[1] // LANES
    low, high = np.empty((3, blocks), np.float32), np.empty((3, blocks), np.float32)
    for axis in range(3):
        for block in range(blocks):
            part = columns[axis, block * LANES : min(n, (block + 1) * LANES)]
            low[axis, block], high[axis, block] = part.min(), part.max()
    return low, high


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
