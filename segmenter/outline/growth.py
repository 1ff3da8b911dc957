"""A view without what its camera added to its outline."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.crop_depth import closed

LEAST_LEFT = 0.25
"""Of a view's pixels: a tuber of which less would be left is too small to be cut, and stays as it is."""


def inside_px(depth: NDArray[np.uint16]) -> NDArray[np.float32]:
    """(h, w) float32 how deep each pixel of a view lies inside its closed outline, 1 for the outermost, 0 outside."""
    seen = np.pad((depth > 0).astype(np.uint8), 1)
    return np.asarray(cv2.distanceTransform(closed(seen), cv2.DIST_L2, cv2.DIST_MASK_5)[1:-1, 1:-1], np.float32)


def without_growth(depth: NDArray[np.uint16], grown_px: float) -> NDArray[np.uint16]:
    """(h, w) `depth` without what lies within `grown_px` of its outline; holes in it stay as large as they are.

    Args:
        depth: (h, w) of a view, 0 outside the tuber. grown_px: 0 leaves it as it is.
    """
    if grown_px <= 0:
        return depth
    # The outermost pixels lie 1 px from what is outside, their outer edges half a pixel.
    left = np.where(inside_px(depth) > grown_px + 0.5, depth, 0).astype(np.uint16)
    return left if np.count_nonzero(left) >= LEAST_LEFT * np.count_nonzero(depth) else depth
