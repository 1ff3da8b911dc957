"""A tuber as one frame shows it: its outline as it is weighed, and its surface, to be compared with other frames'."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.crop_depth import clean_depth, closed, fill_holes, filled_rows, pixel_width_m, step_units
from conveyor.messages import Frame
from segmenter.frame.instances import Instances
from segmenter.track.views import Candidate

PAD_PX = 12
"""Around a crop: how far beyond its outline another frame's surface may reach and still be compared."""
FINE_PX, SOFT_PX = 3, 2.0
"""Side of the box that takes the worst of the noise off what is compared (one of 5 px rounds rims off by 0.2 px), and
width of the blur for laying one frame's surface on another's, which follows the slopes of many pixels."""
BEYOND = cv2.BORDER_CONSTANT
LEAST_PIXELS = 100


@dataclass(frozen=True, slots=True)
class Body:
    """A tuber in one frame; rows and columns count from `PAD_PX` before the crop's first pixel.

    Attributes:
        travel_m: of the belt in that frame. belt_from_camera: (4, 4).
        camera: (4,) fx, fy, cx, cy in pixels of these rows and columns.
        depth_m: (h, w) lightly smoothed, 0 outside. soft_m: (h, w) smoothed more, 0 outside.
        rim_px: (h, w) how deep a pixel lies inside the closed outline, 1 for its outermost ones, 0 outside.
        beside: (h, w) what belongs to others.
    """

    travel_m: float
    belt_from_camera: NDArray[np.float64]
    camera: NDArray[np.float64]
    depth_m: NDArray[np.float32]
    soft_m: NDArray[np.float32]
    rim_px: NDArray[np.float32]
    beside: NDArray[np.bool_]


def _beside(candidate: Candidate, instances: Instances, index: int) -> NDArray[np.bool_]:
    """(h, w) bool: which pixels of a crop of instance `index`, and of `PAD_PX` around it, belong to others."""
    stride, labels = instances.stride, instances.labels
    rows, columns = (
        np.arange(first - PAD_PX, first + size + PAD_PX) // stride
        for first, size in zip((candidate.v0, candidate.u0), candidate.depth.shape, strict=True)
    )
    i, j = (np.clip(cells, 0, size - 1) for cells, size in zip((rows, columns), labels.shape, strict=True))
    around = labels[np.ix_(i, j)]
    return np.asarray((around > 0) & (around != index + 1))


def body_of(frame: Frame, candidate: Candidate, instances: Instances, index: int, *, travel_m: float) -> Body | None:
    """Instance `index` of a frame, cut out of it as `candidate`: outline and surface, cleaned as a regressor cleans a
    view; None where too little of it has depth.
    """
    k, scale_m = frame.intrinsics, frame.depth_scale_m
    pixel_m = pixel_width_m(candidate.belt_from_camera, k.fx)
    depth, _ = filled_rows(np.pad(candidate.depth, PAD_PX), step_units(scale_m, pixel_m))
    kept = clean_depth(depth, scale_m, pixel_m)
    filled = kept * np.float64(scale_m)
    fill_holes(filled)
    seen = (filled > 0).astype(np.uint8)
    if np.count_nonzero(seen) < LEAST_PIXELS:
        return None
    return Body(
        travel_m=travel_m,
        belt_from_camera=candidate.belt_from_camera,
        camera=np.array([k.fx, k.fy, k.cx - candidate.u0 + PAD_PX, k.cy - candidate.v0 + PAD_PX]),
        depth_m=_smoothed(filled, seen, lambda image: cv2.blur(image, (FINE_PX, FINE_PX), borderType=BEYOND)),
        soft_m=_smoothed(filled, seen, lambda image: cv2.GaussianBlur(image, (0, 0), SOFT_PX, borderType=BEYOND)),
        rim_px=np.asarray(cv2.distanceTransform(closed(seen), cv2.DIST_L2, cv2.DIST_MASK_5), np.float32),
        beside=_beside(candidate, instances, index),
    )


def _smoothed(
    depth_m: NDArray[np.float64], seen: NDArray[np.uint8], smooth: Callable[[NDArray[np.float32]], Any]
) -> NDArray[np.float32]:
    """Of what is seen alone; 0 elsewhere."""
    share = np.maximum(smooth(seen.astype(np.float32)), np.float32(1e-6))
    return np.where(seen, smooth(depth_m.astype(np.float32)) / share, np.float32(0))
