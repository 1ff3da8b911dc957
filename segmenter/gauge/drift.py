"""Depth without a drift of disparity: a constant that is added to 1/z of all that is seen."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

COARSE_M, FINER = 0.0005, 10
"""Depth in units from the first on is told in units of a tenth of them: a correction that is rounded to whole
millimetres again moves each depth by up to half of one, a belt by as much, and a load by 1 %."""


def without_drift(
    depth: NDArray[np.uint16], *, depth_scale_m: float, drift_per_m: float
) -> tuple[NDArray[np.uint16], float]:
    """((h, w) depth as it was before 1/z grew by `drift_per_m`, 0 where there is none; metres per unit of it).

    The unit is the same whatever the drift, finer than the camera's where that is coarse.
    """
    finer = FINER if depth_scale_m >= COARSE_M else 1
    if drift_per_m == 0 and finer == 1:
        return depth, depth_scale_m
    return depth_table(drift_per_m, depth_scale_m=depth_scale_m, finer=finer)[depth], depth_scale_m / finer


@lru_cache(maxsize=8)
def depth_table(drift_per_m: float, *, depth_scale_m: float, finer: int = 1) -> NDArray[np.uint16]:
    """(65536,) uint16: the depth that each depth value stands for when 1/z is too large by `drift_per_m`.

    Args:
        depth_scale_m: metres per unit of the values. finer: units of the depth in one of theirs.
    """
    units = np.arange(1 << 16, dtype=np.float64)
    inverse = 1 / (np.maximum(units, 1) * depth_scale_m) - drift_per_m
    right = np.where(inverse > 0, np.round(finer / np.maximum(inverse, 1e-9) / depth_scale_m), 0)
    right[(right > 65535) | (units == 0)] = 0
    return right.astype(np.uint16)
