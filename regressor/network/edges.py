"""The edges of a set abstraction as plain loops: the differences before its products and the maximum after them; and of
the last stage, which has no edges, the units that are awake.

NumPy would pass over the block several times (subtract, ReLU, maximum) where once is enough. LLVM vectorises the inner
loops; the products in between are a library's. The bfloat16 variants hold bit patterns in uint16, as NumPy has no such
type: subtraction is in float32 and rounds once, to the nearest, as the processor would.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel


@kernel(nogil=True)
def edge_differences(source: NDArray[np.float32], centroid: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    """max(source_k - centroid_c, 0) of every pair into `out` (C * K, W); source (K, W), centroid (C, W)."""
    neighbours, width = source.shape
    for c in range(len(centroid)):
        for k in range(neighbours):
            for w in range(width):
                value = source[k, w] - centroid[c, w]
                out[c * neighbours + k, w] = value if value > np.float32(0) else np.float32(0)


@kernel(nogil=True)
def edge_differences_bfloat16(
    source: NDArray[np.float32], centroid: NDArray[np.float32], out: NDArray[np.uint16]
) -> None:
    """As `edge_differences`, into the bits of bfloat16."""
    neighbours, width = source.shape
    row = np.empty(width, np.float32)
    bits = row.view(np.uint32)
    for c in range(len(centroid)):
        for k in range(neighbours):
            for w in range(width):
                value = source[k, w] - centroid[c, w]
                row[w] = value if value > np.float32(0) else np.float32(0)
            for w in range(width):
                odd = (bits[w] >> np.uint32(16)) & np.uint32(1)
                out[c * neighbours + k, w] = np.uint16((bits[w] + np.uint32(0x7FFF) + odd) >> np.uint32(16))


@kernel(nogil=True)
def add_bias_relu(values: NDArray[np.float32], bias: NDArray[np.float32]) -> None:
    """ReLU of (R, O) values plus their (O,) bias, in place."""
    rows, width = values.shape
    for row in range(rows):
        for o in range(width):
            value = values[row, o] + bias[o]
            values[row, o] = value if value > np.float32(0) else np.float32(0)


@kernel(nogil=True)
def pooled_maximum(values: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    """The maximum over each of the C groups of equal size: values (C * K, O) into `out` (C, O)."""
    groups, width = out.shape
    size = len(values) // groups
    for c in range(groups):
        for o in range(width):
            out[c, o] = values[c * size, o]
        for k in range(1, size):
            for o in range(width):
                value = values[c * size + k, o]
                out[c, o] = value if value > out[c, o] else out[c, o]


@kernel(nogil=True)
def pooled_maximum_bfloat16(values: NDArray[np.int16], out: NDArray[np.float32]) -> None:
    """As `pooled_maximum`, of the bits of bfloat16.

    Flipping the lower bits of negative numbers orders bit patterns as their values are ordered, so that integers can be
    compared; the same flip leads back.
    """
    groups, width = out.shape
    size = len(values) // groups
    best = np.empty(width, np.int16)
    bits = np.empty(width, np.uint32)
    floats = bits.view(np.float32)
    for c in range(groups):
        best[:] = np.int16(-32768)
        for k in range(size):
            for o in range(width):
                value = values[c * size + k, o]
                ordered = value ^ ((value >> np.int16(15)) & np.int16(0x7FFF))
                best[o] = max(best[o], ordered)
        for o in range(width):
            back = best[o] ^ ((best[o] >> np.int16(15)) & np.int16(0x7FFF))
            bits[o] = np.uint32(np.uint16(back)) << np.uint32(16)
        for o in range(width):
            out[c, o] = floats[o]


@kernel(nogil=True)
def live_units(values: Any, weights: Any, step: int) -> tuple[Any, Any]:
    """What a product of activations behind a ReLU and the weights needs: units that are zero in all rows add nothing.

    Args:
        values: (R, I) bits of float32 or bfloat16 as integers. weights: (I, O), likewise.
        step: the live units are filled up to a multiple of this with others: few shapes of a product, each compiled
            once.

    Returns:
        (R, L) columns of `values` and (L, O) rows of `weights`, in their order.
    """
    rows, units = values.shape
    awake = np.zeros(units, np.bool_)
    for row in range(rows):
        for unit in range(units):
            awake[unit] |= values[row, unit] != 0
    live = int(awake.sum())
    size = min(units, max(1, -(-live // step)) * step)
    asleep = size - live
    kept = np.empty(size, np.int64)
    count = 0
    for unit in range(units):
        if awake[unit] or asleep > 0:
            asleep -= not awake[unit]
            kept[count] = unit
            count += 1
    columns = np.empty((rows, size), values.dtype)
    for row in range(rows):
        for k in range(size):
            columns[row, k] = values[row, kept[k]]
    picked = np.empty((size, weights.shape[1]), weights.dtype)
    for k in range(size):
        picked[k] = weights[kept[k]]
    return columns, picked
