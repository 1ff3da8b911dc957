"""A picture of what the segmenter found in a frame: height in grey, instances in colour, centres and the centre row.

What the classifier takes for a clod, a stone or haulm is red with a cross over it.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.files import whole_output
from conveyor.messages import Frame
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.instances import Instances, full_resolution

FULL_MM = 90.0
RED = (0, 0, 255)


def picture(
    frame: Frame, instances: Instances, belt: BeltGeometry, *, rejected: NDArray[np.bool_] | None = None
) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 BGR at the frame's own resolution.

    Args:
        rejected: (n,) which instances the classifier takes for no tubers; None: there is no classifier.
    """
    refused = np.zeros(len(instances), bool) if rejected is None else rejected
    a, b, c, t = belt.height_coefficients()
    v, u = np.ogrid[: frame.depth.shape[0], : frame.depth.shape[1]]
    height_mm = np.where(frame.depth > 0, (frame.depth * frame.depth_scale_m * (a * u + b * v + c) + t) * 1000, 0)
    grey = np.clip(height_mm / FULL_MM * 215 + 40, 0, 255).astype(np.uint8)
    grey[frame.depth == 0] = 0
    image = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    labels = full_resolution(instances, frame.depth)
    colours = _colours(len(instances))
    colours[1:][refused] = RED
    image[labels > 0] = (0.6 * image[labels > 0] + 0.4 * colours[labels[labels > 0]]).astype(np.uint8)
    edges = cv2.morphologyEx(labels, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0
    image[edges] = (255, 255, 255)
    row = round(frame.intrinsics.cy)
    cv2.line(image, (0, row), (frame.intrinsics.width - 1, row), (0, 220, 255), 1)
    for n, (x_m, y_m) in enumerate(instances.centre_m.tolist()):
        at = belt.project(x_m, y_m, float(instances.height_m[n]) / 2)
        kind, size = (cv2.MARKER_TILTED_CROSS, 31) if refused[n] else (cv2.MARKER_CROSS, 9)
        cv2.drawMarker(image, (round(at[0]), round(at[1])), RED, kind, size, 1)
    return np.asarray(image, np.uint8)


def save_picture(path: Path, image: NDArray[np.uint8]) -> None:
    """Write a PNG.

    Raises:
        InputError: it cannot be written there.
    """
    # Encoded in memory: of a disk cv2 says only that it did not work.
    _, encoded = cv2.imencode(".png", image)
    with whole_output(path) as partial:
        partial.write_bytes(encoded.tobytes())


def _colours(n: int) -> NDArray[np.float64]:
    """(n + 1, 3) distinct BGR colours, none of them red; row 0 is never used."""
    hue = (15 + np.arange(n + 1) * 67 % 150).astype(np.uint8)
    full = np.full(n + 1, 255, np.uint8)
    bgr = cv2.cvtColor(np.stack([hue, full, full], axis=1)[None], cv2.COLOR_HSV2BGR)
    return np.asarray(bgr[0], np.float64)
