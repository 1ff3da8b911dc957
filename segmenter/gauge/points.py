"""Pixels of a frame in the coordinates of the belt as it is calibrated."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from conveyor.messages import Frame
from segmenter.frame.belt import BeltGeometry

Floats = NDArray[np.float64]


def depths_m(frame: Frame, *, stride: int) -> Floats:
    """(h, w) depth of every `stride`-th column, metres; NaN where there is none."""
    depth = frame.depth[:, ::stride]
    return np.where(depth > 0, depth * frame.depth_scale_m, np.nan)


def rays(frame: Frame, belt: BeltGeometry, *, stride: int) -> tuple[Floats, Floats, Floats]:
    """(along, across, up), each (h, w): belt coordinates that a pixel gains with each metre of depth."""
    k, m = belt.intrinsics, belt.belt_from_camera
    x = ((np.arange(0, frame.depth.shape[1], stride) - k.cx) / k.fx)[None, :]
    y = ((np.arange(frame.depth.shape[0]) - k.cy) / k.fy)[:, None]
    along, across, up = (m[i, 0] * x + m[i, 1] * y + m[i, 2] for i in range(3))
    return along, across, up
