"""An outline that a camera let grow: cut back to the body.

A stereo camera's matching window carries a tuber's disparity out over its outline. Cleaning cuts the step in depth that
lies between the body and the grown pixels, but leaves scraps of them outside: strips one or two pixels wide, as high as
the body's own rim. The filling of holes then closes the gap between, and the tuber is weighed as large as it was grown.
Scraps of mixed pixels lie outside, too, on any stereo camera, but low: those the weights know, and they stay.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.crop_depth import PART, closed
from conveyor.geometry import height_coefficients
from conveyor.kernels import kernel
from conveyor.messages import View

SCRAPS_CUT = "scraps_cut"
"""Flag of a view whose scraps were cut off before it was weighed."""
OPENING_PX = 5
"""What is narrower than such a disc is a scrap. With 3 px, loads seen by cameras that grow outlines stay 1 to 2 %
heavier (tuned, as all here, on recordings of `easy`, `field` and `harsh`, as they were and with frames grown by 2 px).
"""
BACK_PX = 1
"""The opened body gets back what lies so near: it rounds off corners and ragged edges that are the tuber's own."""
OUTER_PX = 8
"""Holes that lie deeper inside the outline are holes of the skin, not a gap before something grown."""
SPOT_PX = 7
"""A hole into which so wide a disc fits is a spot of the skin, and the rim beyond it the tuber's own."""
HIGH = 0.5
"""Of the top's height: mixed pixels stand at 0.15 to 0.35 of it, grown ones at 0.25 to 0.7."""
LEAST_SHARE = 0.005
"""Of a view's pixels that are high scraps, from which on its outline has grown: so 0 to 7 % of the views of a recording
of `easy` or `field`, which moves no load by more than 0.1 %, and 97 % or more once frames are grown by 2 px."""

MOST_DROPPED = 0.05
"""Of a view's pixels that cleaning took: more is noise, and what lies beyond its gaps is the tuber's own flank. Before
cameras that grow outlines it is 2 to 3 %, before the noisiest of `harsh` 8 to 21 %: cut back, their loads were 16 %
lighter still."""

_DISC = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (OPENING_PX, OPENING_PX))
_SPOT = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (SPOT_PX, SPOT_PX))
_CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))


def view_heights_m(kept: NDArray[np.uint16], view: View) -> NDArray[np.float64]:
    """(h, w) heights above the resting level of a view's pixels."""
    a, b, c, t = height_coefficients(view.intrinsics, view.belt_from_camera)
    c += a * view.u0 + b * view.v0
    heights: NDArray[np.float64] = _tilted(kept, view.depth_scale_m, a, b, c, t + view.resting_offset_m)
    return heights


@kernel(nogil=True)
def _tilted(kept: NDArray[np.uint16], scale_m: float, a: float, b: float, c: float, t: float) -> NDArray[np.float64]:
    """By coefficients of the crop's own pixels."""
    rows, columns = kept.shape
    heights = np.empty((rows, columns))
    for v in range(rows):
        for u in range(columns):
            heights[v, u] = kept[v, u] * scale_m * (a * u + b * v + c) + t
    return heights


def cut_back(
    depth: NDArray[np.uint16], cleaned: NDArray[np.uint16], heights_m: NDArray[np.float64]
) -> NDArray[np.uint16] | None:
    """`cleaned` without all scraps outside the body, where enough of them are high; None where nothing has grown.

    Args:
        depth: (h, w) of the view, 0 = none. cleaned: the same by `clean_depth`.
        heights_m: (h, w) above the resting level; counts where `cleaned` has depth.
    """
    measured = cleaned > 0
    if np.count_nonzero(measured) < (1 - MOST_DROPPED) * np.count_nonzero(depth):
        return None
    body = _body(measured)
    scraps = measured & ~body
    least = LEAST_SHARE * np.count_nonzero(measured)
    if np.count_nonzero(scraps) < max(least, 1) or not body.any():
        return None
    top_m = np.quantile(heights_m[measured], 0.99)
    if np.count_nonzero(scraps & (heights_m > HIGH * top_m)) < least:
        return None
    return np.where(body, cleaned, 0).astype(np.uint16)


def _body(measured: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(h, w) the largest part of what is measured that the opening leaves; holes in its skin cut nothing off. Nothing
    where another is a `PART` of it: those are a tuber with something across it, and no scraps.
    """
    seen = np.pad(measured.astype(np.uint8), OPENING_PX)
    filled = closed(seen)
    holes = ((filled > 0) & ~(seen > 0)).astype(np.uint8)
    whole = seen
    if holes.any():
        deep = cv2.distanceTransform(filled, cv2.DIST_L2, cv2.DIST_MASK_5) > OUTER_PX
        spots = np.asarray(cv2.dilate(cv2.morphologyEx(holes, cv2.MORPH_OPEN, _SPOT), _DISC), np.uint8) & holes
        whole = seen | deep.astype(np.uint8) | spots
    opened = cv2.morphologyEx(whole, cv2.MORPH_OPEN, _DISC)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(opened, connectivity=4)
    areas = stats[1:, cv2.CC_STAT_AREA]
    if count < 2 or np.count_nonzero(areas >= PART * areas.max()) > 1:
        return np.zeros_like(measured)
    largest = (labels == 1 + int(areas.argmax())).astype(np.uint8)
    body = np.asarray(cv2.dilate(largest, _CROSS, iterations=BACK_PX), np.uint8) > 0
    inner = slice(OPENING_PX, -OPENING_PX)
    return body[inner, inner] & measured
