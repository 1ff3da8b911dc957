"""A cloud that was made of a depth image is that image again.

A camera's cloud loses its pixels when it is written as a list of points, but not for good: x / z and y / z are columns
and rows of a pinhole camera, all a whole number of steps apart. Found again, the cloud is cleaned, filled and measured
as the image was, so a tuber weighs the same from its `.ply` and from its depth image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

UNITS_M = (1e-3, 1e-4, 1e-5)
"""Depth units that cameras store; the last is fine enough for any, up to 0.65 m."""
OFF_UNIT = 0.01
"""A depth is a multiple of a unit if it is off by less than this share of one: float32 leaves 0.0003 of 0.1 mm."""
OFF_GRID = 0.3
"""A point lies on the grid if it is off by less than this share of a pixel: 0.1 mm of rounding are 0.1 to 0.2 of one.
Without a grid every point would have to fall so near by chance, three in five along each axis."""
MOST_SIDE = 4096
FEWEST_POINTS = 30
FEWEST_BESIDE = 3.2
"""Of the four pixels beside one, how many the cloud has too, in the mean; fewer where some were left out at random."""


@dataclass(frozen=True, slots=True)
class PixelGrid:
    """A depth image and its camera, as `prepare_depth` takes them.

    Attributes:
        depth: (h, w) uint16 in units of `depth_scale_m` metres, 0 where the cloud has no point.
        fx, fy, cx, cy: pixels; cx and cy count from this crop's first pixel.
    """

    depth: NDArray[np.uint16]
    depth_scale_m: float
    fx: float
    fy: float
    cx: float
    cy: float


def gridded(points: NDArray[np.float64], *, most: int) -> tuple[NDArray[np.float64], PixelGrid | None]:
    """A cloud, and the image that it was made of where it has `most` points or fewer and was made of one.

    Points that stand in it several times count once: the density of a cloud says how large its pixels are. Among ten
    times `most` they are looked for; larger clouds are thinned out.
    """
    image = pixel_grid(points) if len(points) <= most else None
    if image is not None or len(points) > 10 * most:
        return points, image
    once = np.sort(np.unique(points, axis=0, return_index=True)[1])
    return (points, None) if len(once) == len(points) else gridded(points[once], most=most)


def pixel_grid(points_in_camera: NDArray[np.float64]) -> PixelGrid | None:
    """The image that a cloud was made of; None where it is not a pinhole camera's, whole, each pixel at most once.

    Args:
        points_in_camera: (N, 3) metres, z > 0 along the optical axis, finite.
    """
    if len(points_in_camera) < FEWEST_POINTS or not (points_in_camera[:, 2] > 0).all():
        return None
    z = points_in_camera[:, 2]
    unit_m = _unit_m(z)
    if unit_m is None:
        return None
    columns, rows = _axis(points_in_camera[:, 0] / z), _axis(points_in_camera[:, 1] / z)
    if columns is None or rows is None:
        return None
    u, fx, cx = columns
    v, fy, cy = rows
    width, height = int(u.max()) + 1, int(v.max()) + 1
    if len(np.unique(v * width + u)) < len(z):
        return None
    units = np.round(z / unit_m)
    if not units.all():  # nearer than half a unit: no camera sees that
        return None
    depth = np.zeros((height, width), np.uint16)
    depth[v, u] = units
    if _beside(depth > 0) < FEWEST_BESIDE:
        return None
    return PixelGrid(depth, unit_m, fx, fy, cx, cy)


def _beside(seen: NDArray[np.bool_]) -> float:
    """How many of the four pixels beside a pixel that is seen are seen too, in the mean."""
    pairs = int((seen[1:] & seen[:-1]).sum()) + int((seen[:, 1:] & seen[:, :-1]).sum())
    return 2 * pairs / int(seen.sum())


def _unit_m(z: NDArray[np.float64]) -> float | None:
    """The coarsest unit of which all depths are multiples, else the finest; None beyond what 16 bits hold of it."""
    for unit_m in UNITS_M[:-1]:
        if float(z.max()) / unit_m < 65535 and float(np.abs(z / unit_m - np.round(z / unit_m)).max()) < OFF_UNIT:
            return unit_m
    return UNITS_M[-1] if float(z.max()) / UNITS_M[-1] < 65535 else None


def _axis(tangents: NDArray[np.float64]) -> tuple[NDArray[np.int64], float, float] | None:
    """((N,) pixel of each tangent counted from the first, focal length, principal point from the first pixel)."""
    found = np.unique(tangents)
    span = float(found[-1] - found[0])
    if span <= 0:
        return None
    # Values of one pixel differ by rounding alone, neighbours by a step: the gaps fall into two heaps far apart.
    gaps = np.diff(found)
    begins = np.concatenate([[0], np.flatnonzero(gaps > _between(gaps, span / MOST_SIDE)) + 1])
    if len(begins) < 3:
        return None
    apart = np.diff(np.add.reduceat(found, begins) / np.diff(begins, append=len(found)))
    usual = float(np.quantile(apart, 0.1))
    # Step by step, for an error of the step adds up over a tuber's width where points are told to 0.01 mm.
    steps = np.round(apart / float(np.mean(apart[apart < 1.5 * usual])))
    pixels = np.concatenate([[0.0], np.cumsum(steps)])
    pixel = pixels[np.searchsorted(found[begins], tangents, side="right") - 1]
    step, first = _line(pixel, tangents)
    if step <= 0:
        return None
    off = np.abs((tangents - first) / step - pixel)
    if float(off.max()) > OFF_GRID or float(pixel.max()) >= MOST_SIDE:
        return None
    return pixel.astype(np.int64), 1 / step, -first / step


def _between(gaps: NDArray[np.float64], least: float) -> float:
    """Where the gaps part into those within a pixel and those between two, which are `least` or more."""
    wide = np.concatenate([[least], np.sort(gaps[gaps > least])])
    if len(wide) < 3 or least == 0:  # too narrow for a difference
        return least
    at = int(np.argmax(wide[1:] / wide[:-1]))
    return float(np.sqrt(wide[at]) * np.sqrt(wide[at + 1]))


def _line(pixel: NDArray[np.float64], tangents: NDArray[np.float64]) -> tuple[float, float]:
    """(step, first) of the least-squares line first + step * pixel."""
    step, first = np.polyfit(pixel, tangents, 1)
    return float(step), float(first)
