"""What `edge_maximum` does to the edges of a block between its products, as plain loops that LLVM vectorises."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel


@kernel(nogil=True)
def add_moments(values: NDArray[np.float32], sums: NDArray[np.float64]) -> None:
    """Adds (R, H) `values` and their squares to the rows of `sums` (2, H)."""
    width = values.shape[1]
    first, second = np.zeros(width, np.float32), np.zeros(width, np.float32)
    for row in range(len(values)):
        for h in range(width):
            first[h] += values[row, h]
            second[h] += values[row, h] * values[row, h]
    for h in range(width):
        sums[0, h] += first[h]
        sums[1, h] += second[h]


@kernel(nogil=True)
def activate(
    values: NDArray[np.float32], scale: NDArray[np.float32], shift: NDArray[np.float32], out: NDArray[np.float32]
) -> None:
    """max(values * scale + shift, 0) into `out`; all (R, H), scale and shift (H,)."""
    rows, width = values.shape
    for row in range(rows):
        for h in range(width):
            value = values[row, h] * scale[h] + shift[h]
            out[row, h] = value if value > np.float32(0) else np.float32(0)


@kernel(nogil=True)
def largest(values: NDArray[np.float32], out: NDArray[np.float32], winner: NDArray[np.uint8]) -> None:
    """The largest of each of the C groups of K rows of (C * K, O) `values`: `out` (C, O), and which of K holds it."""
    groups, width = out.shape
    size = len(values) // groups
    for c in range(groups):
        for o in range(width):
            out[c, o] = values[c * size, o]
            winner[c, o] = 0
        for k in range(1, size):
            for o in range(width):
                larger = values[c * size + k, o] > out[c, o]
                out[c, o] = values[c * size + k, o] if larger else out[c, o]
                winner[c, o] = np.uint8(k) if larger else winner[c, o]


@kernel(nogil=True)
def pass_back(
    gradient: NDArray[np.float32],
    winner: NDArray[np.uint8],
    inputs: NDArray[np.float32],
    affine: NDArray[np.float32],
    w3: NDArray[np.float32],
    row_of: NDArray[np.int32],
    out: NDArray[np.float32],
    w3_gradient: NDArray[np.float32],
    sums: NDArray[np.float64],
) -> int:
    """From the (C, O) `gradient` of the maxima to that behind the norm, for the edges that hold one.

    Args:
        inputs: (C * K, H) of the norm; affine: its scale and shift, (2, H).
        row_of: (C * K,) is given each holding edge's row of `out` (its first rows, (n, H)); -1 for all others.
        w3_gradient, sums: (O, H) and (2, H), added to.

    Returns:
        n.
    """
    groups, channels = gradient.shape
    edges, width = inputs.shape
    size = edges // groups
    awake = np.empty((edges, width), np.float32)
    count = 0
    for c in range(groups):
        for o in range(channels):
            edge = c * size + winner[c, o]
            row = row_of[edge]
            if row < 0:
                row = count
                row_of[edge] = row
                count += 1
                activate(inputs[edge : edge + 1], affine[0], affine[1], awake[row : row + 1])
                out[row, :] = np.float32(0)
            share = gradient[c, o]
            for h in range(width):
                out[row, h] += share * w3[o, h]
            for h in range(width):
                w3_gradient[o, h] += share * awake[row, h]
    for edge in range(edges):
        row = row_of[edge]
        if row >= 0:
            for h in range(width):
                value = out[row, h] if awake[row, h] > np.float32(0) else np.float32(0)
                out[row, h] = value
                sums[0, h] += value
                sums[1, h] += value * inputs[edge, h]
    return count


@kernel(nogil=True)
def gather_edges(
    source: NDArray[np.float32], centroid: NDArray[np.float32], row_of: NDArray[np.int32], out: NDArray[np.float32]
) -> None:
    """The edges that have a row, into that row of `out` (n, W)."""
    neighbours, width = source.shape
    for edge in range(len(row_of)):
        row = row_of[edge]
        if row >= 0:
            c, k = edge // neighbours, edge % neighbours
            for w in range(width):
                value = source[k, w] - centroid[c, w]
                out[row, w] = value if value > np.float32(0) else np.float32(0)


@kernel(nogil=True)
def spread_back(
    points: tuple[NDArray[np.float32], NDArray[np.float32]],
    passed: NDArray[np.float32],
    row_of: NDArray[np.int32],
    common: NDArray[np.float32],
    level: NDArray[np.float32],
    gradients: tuple[NDArray[np.float32], NDArray[np.float32]],
    edge_sum: NDArray[np.float64],
) -> None:
    """From edges to the neighbours and centroids they join.

    Args:
        points: source (K, W) and centroid (C, W).
        passed: (n, W) of the edges with a row; common (C * K, W) and level (W,) are taken off all edges.
        gradients: of source and centroid, added to. edge_sum: (W,), the edges are added to it.
    """
    source, centroid = points
    of_source, of_centroid = gradients
    neighbours, width = source.shape
    nought = np.zeros(width, np.float32)
    total = np.zeros(width, np.float32)
    for c in range(len(centroid)):
        for k in range(neighbours):
            row = row_of[c * neighbours + k]
            more = passed[row] if row >= 0 else nought
            for w in range(width):
                edge = source[k, w] - centroid[c, w]
                open_ = edge > np.float32(0)
                value = more[w] - common[c * neighbours + k, w] - level[w] if open_ else np.float32(0)
                total[w] += edge if open_ else np.float32(0)
                of_source[k, w] += value
                of_centroid[c, w] -= value
    for w in range(width):
        edge_sum[w] += total[w]
