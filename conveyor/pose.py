"""Is `belt_from_camera` a rigid transform? Every format is asked the same and refused in the same words."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

TOLERANCE = 1e-3
"""Of each entry of R R^T against the identity: poses are written with four digits or more."""

LEAST_DOWN = 0.1
"""Of the optical axis, along the belt's normal: 84 degrees from straight down."""


def pose_fault(belt_from_camera: NDArray[np.float64] | list[list[float]]) -> str | None:
    """What is wrong with a (4, 4) pose, the rest of a sentence that begins with where it stands; None: nothing."""
    try:
        pose = np.asarray(belt_from_camera, np.float64)
    except (TypeError, ValueError):  # rows of unequal length
        return f"belt_from_camera must be 4 rows of 4 numbers, got {belt_from_camera}"
    if pose.shape != (4, 4):
        return f"belt_from_camera must be 4 rows of 4 numbers, got {pose.shape}"
    rotation = pose[:3, :3]
    rigid = np.isfinite(pose).all() and np.allclose(rotation @ rotation.T, np.eye(3), atol=TOLERANCE)
    if rigid and np.linalg.det(rotation) > 0 and np.allclose(pose[3], [0, 0, 0, 1]):
        return _away_from_the_belt(pose)
    return (
        "belt_from_camera is no rigid transform (rotation rows must be orthonormal and right-handed, the last row "
        f"0 0 0 1), got {pose.tolist()}; take it from `tuberline calibrate belt`"
    )


def _away_from_the_belt(pose: NDArray[np.float64]) -> str | None:
    if -pose[2, 2] > LEAST_DOWN and pose[2, 3] > 0:
        return None
    return (
        "belt_from_camera points the optical axis away from the belt: the third row must be the height over the belt, "
        f"its third number negative (-1: straight down) and its last one positive, got {pose[2].tolist()}; take it "
        "from `tuberline calibrate belt`"
    )
