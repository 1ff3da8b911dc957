"""How long and how wide an outline is: the longest of its widths over half a turn, and the one across it.

A width is what lies between two quantiles of the places along a direction, with NumPy's own numbers. Only values near
the two ends decide them: of each block of points the ends along every direction are known first, and blocks that
cannot reach the outermost values are passed by.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel

TRIMMED = 0.005
"""Share of the outline's pixels that are left out at either end of a width: single ones say little."""
ANGLES = np.deg2rad(np.arange(0.0, 180.0, 5.0))
DIRECTIONS = np.stack([np.cos(ANGLES), np.sin(ANGLES)])
"""(2, 36) unit vectors in the level plane."""
BLOCK = 64
"""Points of a block; 32 and 128 are as fast within a tenth."""


def longest_widths(level: NDArray[np.float64]) -> tuple[float, float]:
    """Longest width of (n, 2 or more) points over `DIRECTIONS`, and the one at right angles to it."""
    found: tuple[float, float] = _longest(level, DIRECTIONS, TRIMMED)
    return found


@kernel(nogil=True)
def _longest(level: NDArray[np.float64], directions: NDArray[np.float64], trimmed: float) -> tuple[float, float]:
    """A direction is left out along which the whole extent is shorter than the longest width so far."""
    many = directions.shape[1]
    x, y = np.ascontiguousarray(level[:, 0]), np.ascontiguousarray(level[:, 1])
    highest, lowest = _ends(x, y, directions)
    extents = np.empty(many)
    for d in range(many):
        extents[d] = highest[d].max() + lowest[d].max()
    longest, length = -1, -np.inf
    for d in np.argsort(-extents):
        if extents[d] < length:
            break
        width = _width(x, y, directions[:, d], highest[d], lowest[d], trimmed)
        if width > length or (width == length and d < longest):
            longest, length = d, width
    across = (longest + many // 2) % many
    return length, _width(x, y, directions[:, across], highest[across], lowest[across], trimmed)


@kernel(nogil=True, fastmath={"nnan", "nsz"})
def _ends(
    x: NDArray[np.float64], y: NDArray[np.float64], directions: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Twice (m, blocks): how far each block of (n,) places reaches along each of (2, m) directions, and against it."""
    n, many = len(x), directions.shape[1]
    blocks = -(-n // BLOCK)
    highest, lowest = np.empty((many, blocks)), np.empty((many, blocks))
    for d in range(many):
        a, b = directions[0, d], directions[1, d]
        for block in range(blocks):
            first = block * BLOCK
            low = high = a * x[first] + b * y[first]
            for k in range(first, min(first + BLOCK, n)):
                value = a * x[k] + b * y[k]
                low, high = min(low, value), max(high, value)
            highest[d, block], lowest[d, block] = high, -low
    return highest, lowest


@kernel(nogil=True)
def _width(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    direction: NDArray[np.float64],
    highest: NDArray[np.float64],
    lowest: NDArray[np.float64],
    trimmed: float,
) -> float:
    """Distance of the quantiles `trimmed` and 1 - `trimmed` of the places along (2,) `direction`, whose blocks reach as
    far as `highest` along it and as far as `lowest` against it.
    """
    n, a, b = len(x), direction[0], direction[1]
    at_low, at_high = trimmed * (n - 1), (1.0 - trimmed) * (n - 1)
    keep = min(n, int(at_low) + 3)
    high, low = _outermost(x, y, a, b, highest, keep), _outermost(x, y, -a, -b, lowest, keep)
    first, last = int(at_low), int(at_high)
    below = between(-low[first], -low[min(first + 1, n - 1)], at_low - first)
    above = between(high[n - 1 - last], high[n - 1 - min(last + 1, n - 1)], at_high - last)
    return above - below


@kernel(nogil=True)
def _outermost(
    x: NDArray[np.float64], y: NDArray[np.float64], a: float, b: float, reach: NDArray[np.float64], keep: int
) -> NDArray[np.float64]:
    """(keep,) the highest values of a x + b y, from the highest on, given the highest of each block.

    The `keep` blocks that reach farthest hold them all: each has a value that none of the other blocks exceeds.
    """
    few = min(keep, len(reach))
    farthest, blocks = np.full(few, -np.inf), np.zeros(few, np.int64)
    for block in range(len(reach)):
        if reach[block] > farthest[few - 1] or block < few:
            i = min(block, few - 1)
            while i > 0 and farthest[i - 1] < reach[block]:
                farthest[i], blocks[i] = farthest[i - 1], blocks[i - 1]
                i -= 1
            farthest[i], blocks[i] = reach[block], block
    found = np.full(keep, -np.inf)
    for i in range(few):
        if farthest[i] <= found[keep - 1]:
            break
        for k in range(blocks[i] * BLOCK, min((blocks[i] + 1) * BLOCK, len(x))):
            value = a * x[k] + b * y[k]
            if value > found[keep - 1]:
                at = keep - 1
                while at > 0 and found[at - 1] < value:
                    found[at] = found[at - 1]
                    at -= 1
                found[at] = value
    return found


@kernel(nogil=True)
def between(a: float, b: float, share: float) -> float:
    """As NumPy interpolates, rounding included."""
    return b - (b - a) * (1.0 - share) if share >= 0.5 else a + (b - a) * share
