"""Tubers cut by the left or right border: where their centre is, though only a part of them is seen.

The centroid of what is seen lies inside the image for every one of them; the ellipse through the free part of the
outline says whether the tuber's own centre does, and where a second camera will see it.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from segmenter.frame.belt import BeltGeometry
from segmenter.frame.instances import Instances
from segmenter.frame.place import centre_in_belt, free_ellipse_centre


def with_own_centres(instances: Instances, belt: BeltGeometry) -> Instances:
    """Instances of which those cut by a side have the centre of the ellipse through their free outline, where there is
    one; the others stay `part`.
    """
    centres, part = instances.centre_m.copy(), instances.part.copy()
    for index in np.flatnonzero(instances.part & ~instances.cut[:, :2].any(axis=1)).tolist():
        found = _ellipse_centre(instances, index)
        if found is not None:
            centres[index] = centre_in_belt(belt, *found, float(instances.height_m[index]))
            part[index] = False
    return replace(instances, centre_m=centres, part=part)


def _ellipse_centre(instances: Instances, index: int) -> tuple[float, float] | None:
    i0, i1, j0, j1 = (int(value) for value in instances.box[index])
    inside = (instances.labels[i0 : i1 + 1, j0 : j1 + 1] == index + 1).astype(np.uint8)
    contours, _ = cv2.findContours(inside, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    largest = max(contours, key=len)
    cells = largest[:, 0].astype(np.float32) + np.array([j0, i0], np.float32)
    stride = instances.stride
    outline = cells * stride + (stride - 1) / 2
    left, right = (bool(side) for side in instances.cut[index, 2:])
    found = free_ellipse_centre(
        outline.astype(np.float32),
        first_u=float(outline[:, 0].min()) if left else -np.inf,
        last_u=float(outline[:, 0].max()) if right else np.inf,
        margin=2.5 * stride,
    )
    if found is None:
        return None
    u, v = found
    half_span = (i1 - i0 + 1) * stride / 2
    near = (
        abs(u - instances.centroid_px[index, 0]) < half_span
        and abs(v - instances.centroid_px[index, 1]) < half_span / 2
    )
    return found if near else None
