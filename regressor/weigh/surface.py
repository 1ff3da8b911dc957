"""What the visible surface of a tuber measures: volume, outline, how its sides fall and how it lies.

All heights count from the resting level, where its underside lies. Cross sections high up and the curvature of the top
do not change when a camera loses the rim; the rim's height tells how much of it was lost, and rim and top together how
the tuber lies (undercut, tilted, standing). How the surface falls in between is `profile`'s.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel
from regressor.weigh.profile import PROFILE_NAMES, rim_profile
from regressor.weigh.widths import between, longest_widths

LEVELS = (0.50, 0.70, 0.85)
"""Of the height: where cross sections are taken."""
LEAST_HEIGHT_M = 0.001
"""What is lower has no top that could be measured; heights are taken to be at least so much."""
CURVATURE_POINTS = 3000
TOP = 0.6
"""Of the height: from there on up the top's curvature is fitted."""
AXIS_POINTS = 2000
LARGEST_RATIO = 4.0
"""An outline area that the curvature implies is at most so many times the visible one, and at least its share."""


@dataclass(frozen=True, slots=True)
class SurfaceFeatures:
    """What the visible surface measures, holes filled.

    Attributes:
        volume_ml: under the surface, down to the resting level. area_cm2: of the outline.
        length_mm, width_mm: longest extent of the outline and the one across it. height_mm: of the top (p99).
        hull_cm2: area of the outline's convex hull: an outline with bites out of it is smaller.
        area50_cm2, area70_cm2, area85_cm2: of what is higher than that share of the height.
        curvature_cm2: area of the equator that the curvature of the top implies.
        rim, rim_low, rim_high: height of the outline's pixels over the height: median, 10 % and 90 %.
        tilt: how far the top lies off the outline's middle, over the outline's mean radius; lean: the part of it that
            points away from the camera.
        hole_share: share of the outline's inside that had no depth. off_axis: tangent of the angle it is seen under.
        profile: (18,) as in `profile.PROFILE_NAMES`.
    """

    volume_ml: float
    area_cm2: float
    length_mm: float
    width_mm: float
    height_mm: float
    hull_cm2: float
    area50_cm2: float
    area70_cm2: float
    area85_cm2: float
    curvature_cm2: float
    rim: float
    rim_low: float
    rim_high: float
    tilt: float
    lean: float
    hole_share: float
    off_axis: float
    profile: tuple[float, ...]

    def as_array(self) -> NDArray[np.float64]:
        """(35,) float64 in the order of `NAMES`."""
        return np.array((*_VALUES(self), *self.profile))


FIRST_NAMES = tuple(name for name in SurfaceFeatures.__dataclass_fields__ if name != "profile")
"""What sizes read, and rules from before there was a profile."""
NAMES = (*FIRST_NAMES, *PROFILE_NAMES)
_VALUES = attrgetter(*FIRST_NAMES)


def surface_features(
    level: NDArray[np.float64],
    areas_m2: NDArray[np.float64],
    inside: NDArray[np.bool_],
    *,
    distance_m: float,
    holes: int,
) -> SurfaceFeatures:
    """Features of the filled pixels of an image.

    Args:
        level: (N, 3) metres, level frame, of the pixels that `inside` marks, in raster order.
        areas_m2: (N,) area on the level plane that each pixel covers.
        inside: (h, w) the outline, holes filled. holes: how many of its pixels had no depth.
        distance_m: of the optical centre above the resting level.
    """
    heights = distance_m - level[:, 2]
    height_m = max(_quantiles(_ranked(heights, 0.99), (0.99,))[0], LEAST_HEIGHT_M)
    length_m, width_m = longest_widths(level[:: max(1, len(level) // AXIS_POINTS)])
    rim, rim_xy = _rim(inside, level, heights)
    low, middle, high = _quantiles(np.sort(rim / height_m), (0.1, 0.5, 0.9)) if len(rim) else (0.5, 0.5, 0.5)
    area_m2, volume_m3, x, y, top_x, top_y, *sections = _sums(level, areas_m2, heights, height_m)
    from_axis, radius_m = math.hypot(x, y), math.sqrt(area_m2 / math.pi)
    off_x, off_y = top_x - x, top_y - y
    return SurfaceFeatures(
        volume_ml=volume_m3 * 1e6,
        area_cm2=area_m2 * 1e4,
        length_mm=length_m * 1e3,
        width_mm=width_m * 1e3,
        height_mm=height_m * 1e3,
        hull_cm2=_hull_m2(rim_xy) * 1e4,
        area50_cm2=sections[0] * 1e4,
        area70_cm2=sections[1] * 1e4,
        area85_cm2=sections[2] * 1e4,
        curvature_cm2=_curvature_m2(level, heights, height_m, area_m2) * 1e4,
        rim=middle,
        rim_low=low,
        rim_high=high,
        tilt=math.hypot(off_x, off_y) / radius_m,
        lean=(off_x * x + off_y * y) / max(from_axis, 1e-6) / radius_m,
        hole_share=holes / len(heights),
        off_axis=from_axis / distance_m,
        profile=tuple(rim_profile(level, areas_m2, inside, heights=heights, height_m=height_m).tolist()),
    )


@kernel(nogil=True)
def _sums(
    level: NDArray[np.float64], areas_m2: NDArray[np.float64], heights: NDArray[np.float64], height_m: float
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """(area, volume, x and y of the outline's middle, x and y of the top's, areas above each of `LEVELS`), metres."""
    highest = heights[0]
    for k in range(len(heights)):
        highest = max(highest, heights[k])
    from_m = min(LEVELS[2] * height_m, highest)  # the top is never empty: all may lie below the level
    area, volume, x, y, top, top_x, top_y = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    low, middle, high = 0.0, 0.0, 0.0
    for k in range(len(heights)):
        a, h = areas_m2[k], heights[k]
        area += a
        volume += a * max(h, 0.0)
        x += a * level[k, 0]
        y += a * level[k, 1]
        low += a if h > LEVELS[0] * height_m else 0.0
        middle += a if h > LEVELS[1] * height_m else 0.0
        high += a if h > LEVELS[2] * height_m else 0.0
        if h >= from_m:
            top += a
            top_x += a * level[k, 0]
            top_y += a * level[k, 1]
    return area, volume, x / area, y / area, top_x / top, top_y / top, low, middle, high


def _quantiles(ordered: NDArray[np.float64], shares: Sequence[float]) -> list[float]:
    """Of sorted values: NumPy's numbers, without what it does around them."""
    found, last = [], len(ordered) - 1
    for share in shares:
        at = share * last
        below = int(at)
        found.append(float(between(ordered[below], ordered[min(below + 1, last)], at - below)))
    return found


def _ranked(values: NDArray[np.float64], share: float) -> NDArray[np.float64]:
    """Values in such an order that those beside the quantile `share` stand where they would stand sorted."""
    below = int(share * (len(values) - 1))
    return np.partition(values, (below, min(below + 1, len(values) - 1)))


@kernel(nogil=True)
def _rim(
    inside: NDArray[np.bool_], level: NDArray[np.float64], heights: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """(n,) heights of the outline's pixels that have a neighbour outside it, or lie at the image's border, and (n, 2)
    where they lie, about the middle of them all, metres.
    """
    rows, columns = inside.shape
    at, n, k = np.empty(len(heights), np.int64), 0, 0
    x, y = 0.0, 0.0
    for v in range(rows):
        for u in range(columns):
            if not inside[v, u]:
                continue
            border = v == 0 or u == 0 or v == rows - 1 or u == columns - 1
            if border or not (inside[v - 1, u] and inside[v + 1, u] and inside[v, u - 1] and inside[v, u + 1]):
                at[n] = k
                x += level[k, 0]
                y += level[k, 1]
                n += 1
            k += 1
    rim, places = np.empty(n), np.empty((n, 2), np.float32)
    for i in range(n):
        k = at[i]
        rim[i] = heights[k]
        places[i, 0], places[i, 1] = level[k, 0] - x / n, level[k, 1] - y / n
    return rim, places


def _hull_m2(rim: NDArray[np.float32]) -> float:
    return float(cv2.contourArea(cv2.convexHull(rim))) if len(rim) >= 3 else 0.0


def _quadric(xy: NDArray[np.float64], heights: NDArray[np.float64], unit: float) -> NDArray[np.float64]:
    """(6,) of 1, x, y, xx, xy, yy: least squares through heights over (n, 2) places, in units of `unit` about their
    middle, with a little ridge.
    """
    normal, right = _normal_equations(xy, heights, unit)
    return np.asarray(np.linalg.solve(normal, right), np.float64)


@kernel(nogil=True)
def _normal_equations(
    xy: NDArray[np.float64], heights: NDArray[np.float64], unit: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(6, 6) and (6,) of `_quadric`: of its 36 sums 15 differ, those of x^i y^j."""
    n = len(xy)
    middle_x, middle_y = xy[:, 0].sum() / n, xy[:, 1].sum() / n
    s10 = s01 = s20 = s11 = s02 = s30 = s21 = s12 = s03 = s40 = s31 = s22 = s13 = s04 = 0.0
    h00 = h10 = h01 = h20 = h11 = h02 = 0.0
    for k in range(n):
        x, y, h = (xy[k, 0] - middle_x) / unit, (xy[k, 1] - middle_y) / unit, heights[k]
        xx, xy_, yy = x * x, x * y, y * y
        s10, s01, s20, s11, s02 = s10 + x, s01 + y, s20 + xx, s11 + xy_, s02 + yy
        s30, s21, s12, s03 = s30 + xx * x, s21 + xx * y, s12 + x * yy, s03 + yy * y
        s40, s31, s22, s13, s04 = s40 + xx * xx, s31 + xx * xy_, s22 + xx * yy, s13 + xy_ * yy, s04 + yy * yy
        h00, h10, h01, h20, h11, h02 = h00 + h, h10 + h * x, h01 + h * y, h20 + h * xx, h11 + h * xy_, h02 + h * yy
    sums = (
        (float(n), s10, s01, s20, s11, s02),
        (s10, s20, s11, s30, s21, s12),
        (s01, s11, s02, s21, s12, s03),
        (s20, s30, s21, s40, s31, s22),
        (s11, s21, s12, s31, s22, s13),
        (s02, s12, s03, s22, s13, s04),
    )
    return np.array(sums) + 1e-6 * n * np.eye(6), np.array((h00, h10, h01, h20, h11, h02))


@kernel(nogil=True)
def _top(
    xy: NDArray[np.float64], heights: NDArray[np.float64], over_m: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Places (of (n, 2 or more)) and heights of what is higher than `over_m`, some `CURVATURE_POINTS` of it."""
    count = 0
    for k in range(len(heights)):
        count += heights[k] > over_m
    step = max(1, count // CURVATURE_POINTS)
    places, high, n, seen = np.empty((-(-count // step), 2)), np.empty(-(-count // step)), 0, 0
    for k in range(len(heights)):
        if heights[k] > over_m:
            if seen % step == 0:
                places[n, 0], places[n, 1], high[n] = xy[k, 0], xy[k, 1], heights[k]
                n += 1
            seen += 1
    return places, high


def _curvature_m2(level: NDArray[np.float64], heights: NDArray[np.float64], height_m: float, area_m2: float) -> float:
    """Area of the equator of the ellipsoid that touches the top with its curvature and is as high as the tuber."""
    unit = float(np.sqrt(area_m2 / np.pi))
    places, high = _top(level, heights, TOP * height_m)
    if not len(high):  # all lies at the resting level or below it: no top, no curvature
        return LARGEST_RATIO * area_m2
    fit = _quadric(places, high, unit)
    # Heights fall by (x^2 / a^2 + y^2 / b^2) c / 2 near the top of an ellipsoid with half axes a, b and c.
    determinant = float(4 * fit[3] * fit[5] - fit[4] ** 2) / unit**4
    if fit[3] >= 0 or fit[5] >= 0 or determinant <= 0:
        return LARGEST_RATIO * area_m2
    implied = float(np.pi * (height_m / 2) / np.sqrt(determinant))
    return float(np.clip(implied, area_m2 / LARGEST_RATIO, LARGEST_RATIO * area_m2))
