"""Depth of a camera whose pixels are wider on the belt than any that weights were trained on, on a finer grid.

What the visible surface measures is told per pixel: the height of the outline's own pixels, how the surface falls from
one to the next. Of pixels of 3 to 5 mm the rule over these features made 6 to 16 % less, though outline and volume are
right; on a grid as fine as those of the training it makes 1 to 3 % more.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.crop_depth import WIDEST_PIXEL_M

MOST_TIMES, MOST_PIXELS = 8, 1 << 20
"""Pixels that are wider still are so few on a tuber that finer ones tell no more; a view of so many has none on it."""
STEEPER = 1 + 3**0.5
"""How much more a rounded rim falls beyond its outermost pixel than up to it. Height goes with the root of the distance
from the outline, 1/2, 3/2, ... pixels in the mean: it is at the belt half a pixel further out."""
_SIDES = ((1, 0), (-1, 0), (0, 1), (0, -1))
_CORNERS = ((1, 1), (1, -1), (-1, 1), (-1, -1))


def times_finer(pixel_m: float, pixels: int, *, longer: float = 1.0) -> tuple[int, int]:
    """By how much a pixel of that width on the belt is divided, down and across, so that none is wider than those of
    the training, and none more than half as long again as wide.

    `pixels`: of the view. One that is far too large for a tuber stays as it is. `longer`: a pixel's length down the
    image over its width.
    """
    times = int(np.clip(np.ceil(pixel_m / WIDEST_PIXEL_M), 1, MOST_TIMES))
    down, across = (min(times * max(1, round(share)), MOST_TIMES) for share in (longer, 1 / longer))
    return (down, across) if pixels * down * across <= MOST_PIXELS else (1, 1)


def finer(depth_m: NDArray[np.float64], times: tuple[int, int]) -> NDArray[np.float64]:
    """(h down, w across) metres of (h, w) metres, 0 where nothing is seen; a principal point c goes to
    times c + (times - 1) / 2.

    Depth is linear between pixels, and falls beyond the outermost ones as a rounded rim does: their outer half would
    else be flat. The outline goes where half of what is around is seen, so its area stays but for corners.
    """
    ringed = np.pad(depth_m, 1)
    share = _enlarged((ringed > 0).astype(np.float64), times)
    return np.where(share > 0.5, _enlarged(_with_ring(ringed), times), 0.0)


def _enlarged(ringed: NDArray[np.float64], times: tuple[int, int]) -> NDArray[np.float64]:
    """(h down, w across), linear between the centres of (h + 2, w + 2) pixels."""
    down, across = times
    fine = np.asarray(cv2.resize(ringed, None, fx=across, fy=down, interpolation=cv2.INTER_LINEAR), np.float64)
    return fine[down:-down, across:-across]


def _with_ring(depth_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """With depth next to what is seen, at corners last: the surface goes on as it came there, `STEEPER`."""
    out, wide = depth_m.copy(), np.pad(depth_m, 2)
    for directions in (_SIDES, _CORNERS):
        total, count = np.zeros_like(out), np.zeros_like(out)
        for dv, du in directions:
            near, next_to = _moved(wide, dv, du), _moved(wide, 2 * dv, 2 * du)
            on = (out == 0) & (near > 0)
            total += np.where(on, np.where(next_to > 0, near + STEEPER * (near - next_to), near), 0.0)
            count += on
        np.divide(total, count, out=out, where=count > 0)
    return out


def _moved(wide: NDArray[np.float64], dv: int, du: int) -> NDArray[np.float64]:
    """Of an array with a border of 2, what lies `dv` rows and `du` columns away from each of its inner pixels."""
    rows, columns = wide.shape
    return wide[2 + dv : rows - 2 + dv, 2 + du : columns - 2 + du]
