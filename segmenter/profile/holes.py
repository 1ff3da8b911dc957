"""Pixels without depth, and islands of false matches: what is missing or wrong in one disparity image."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.depth_noise import Disparity

OUTLINE_JUMP_PX = 0.75
"""A hole whose two ends differ by more lies at an outline; one on a surface ends where it began."""
WIDEST_PX = 60
"""Wider gaps are no outline's hole."""
SAME_SURFACE_PX = 1.0
"""Neighbours closer than this in disparity are one surface."""
ISLAND_AREA_PX = (4, 700)
"""Pixels of an island; larger ones may be bodies."""
ISLAND_OFF_PX = 3.0
"""Of disparity that an island is off the surface around it; a clod as small as an island is 1 px high."""
RING_PX = 5
RING_SEEN, RING_EVEN_PX = 0.5, 2.0
"""Share of an island's surroundings that must have depth, and how far apart their 10 and 90 % quantiles may lie."""
_FINE = 16


@dataclass(frozen=True, slots=True)
class Islands:
    """False matches of an image: `off_px` (n,) by how much each is off; negative is too far away."""

    off_px: NDArray[np.float64]


def outline_widths_px(d: Disparity) -> NDArray[np.int64]:
    """(n,) lengths of the runs without depth, along rows and columns, whose two ends lie on two surfaces.

    Args:
        d: (h, w) disparity in pixels, 0 = none.
    """
    return np.concatenate([_widths(d), _widths(np.ascontiguousarray(d.T))])


def islands(d: Disparity) -> Islands:
    """Small pieces far off the even surface around them.

    Args:
        d: (h, w) disparity in pixels, 0 = none.
    """
    fixed = np.minimum(d * _FINE, 32000).astype(np.int16)
    kept = fixed.copy()
    cv2.filterSpeckles(kept, 0, ISLAND_AREA_PX[1], SAME_SURFACE_PX * _FINE)
    small = ((kept == 0) & (fixed > 0)).astype(np.uint8)
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(small, connectivity=4)
    off = [_off_px(d, small, labels, n, boxes[n]) for n in range(1, count) if boxes[n][4] >= ISLAND_AREA_PX[0]]
    return Islands(np.array([px for px in off if px is not None and abs(px) >= ISLAND_OFF_PX]))


def _widths(d: Disparity) -> NDArray[np.int64]:
    rows, columns = np.nonzero(d > 0)
    same_row = rows[1:] == rows[:-1]
    gap = columns[1:] - columns[:-1] - 1
    at = np.flatnonzero(same_row & (gap > 0) & (gap <= WIDEST_PX))
    jump = np.abs(d[rows[at + 1], columns[at + 1]] - d[rows[at], columns[at]])
    return np.asarray(gap[at][jump > OUTLINE_JUMP_PX], np.int64)


def _off_px(
    d: Disparity, small: NDArray[np.uint8], labels: NDArray[np.int32], n: int, box: NDArray[np.int32]
) -> float | None:
    """How far piece `n` is off its surroundings; None where these are not one even surface."""
    u, v, width, height = (int(value) for value in box[:4])
    rows = slice(max(0, v - RING_PX), v + height + RING_PX)
    columns = slice(max(0, u - RING_PX), u + width + RING_PX)
    piece = (labels[rows, columns] == n).astype(np.uint8)
    grown = cv2.dilate(piece, np.ones((2 * RING_PX + 1, 2 * RING_PX + 1), np.uint8))
    ring = (grown > 0) & (piece == 0)
    around = d[rows, columns][ring & (d[rows, columns] > 0) & (small[rows, columns] == 0)]
    if not len(around) or len(around) < RING_SEEN * np.count_nonzero(ring):
        return None
    low, middle, high = np.quantile(around, [0.1, 0.5, 0.9])
    if high - low > RING_EVEN_PX:
        return None
    return float(np.median(d[rows, columns][piece > 0]) - middle)
