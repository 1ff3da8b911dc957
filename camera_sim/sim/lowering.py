"""How deep a body sinks that is lowered, in its pose, onto rods or cleats that lie across the belt.

Both reach across the whole belt, so what counts is the body's lowest point over each x, as seen from the side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camera_sim.sim.meshes import Faces, Vertices, icosphere, rotation_about
from conveyor.kernels import kernel

STEP_M = 0.0005
COARSE_M = 0.001
LARGEST_SINK = 0.45
"""Of a body's height: what would sink deeper falls through a web and is not on it; it is held there."""
MEAN_AXES_MM = (76.3, 62.5, 51.9)
"""Of the 339 tubers of 2023."""


@dataclass(frozen=True, slots=True)
class Support:
    """What lies across the belt: (n,) heights in metres over one period from x = 0; -inf where there is nothing."""

    period_m: float
    height_m: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Underside:
    """(n,) lowest z of a body over x = first_m, first_m + STEP_M, ..., metres; `height_m` is that of its box."""

    first_m: float
    lowest_m: NDArray[np.float64]
    height_m: float


def underside_of(vertices: Vertices, faces: Faces) -> Underside:
    """The lower outline of a mesh seen along y: the lowest point of its edges over each x."""
    x, z = np.ascontiguousarray(vertices[:, 0]), np.ascontiguousarray(vertices[:, 2])
    first = np.ceil(x.min() / STEP_M) * STEP_M
    lowest = np.full(max(1, int((x.max() - first) / STEP_M) + 1), np.inf)
    _lower_edges(x, z, faces, first, lowest)
    return Underside(float(first), lowest, float(np.ptp(z)))


def rest_height_m(underside: Underside, support: Support, x_m: float) -> float:
    """z by which the body is lifted, moved to `x_m`, so that it touches the support and nothing of it lies inside."""
    return float(_rest_heights(underside, support, np.array([x_m]))[0])


def settled(underside: Underside, support: Support, x_m: float, *, backwards: bool = False) -> tuple[float, float]:
    """(x, z) where a body comes to rest that is put down at `x_m`: as long as it can sink deeper it moves on.

    `backwards`: it only moves towards -x, by one period at most.
    """
    reach = round(support.period_m / COARSE_M)
    offsets = -np.arange(reach + 1) if backwards else np.arange(-(reach // 2), reach // 2 + 1)
    at_m = np.asarray(x_m + COARSE_M * offsets, np.float64)
    coarse = _downhill(_rest_heights(underside, support, at_m), 0 if backwards else reach // 2)
    fine_m = np.asarray(at_m[coarse] + np.arange(-20, 21) * (COARSE_M / 20), np.float64)
    if backwards:
        fine_m = np.minimum(fine_m, x_m)
    heights = _rest_heights(underside, support, fine_m)
    best = int(np.argmin(heights))
    return float(fine_m[best]), float(heights[best])


def _downhill(heights: NDArray[np.float64], at: int) -> int:
    """Where one comes to rest who goes downhill from `at`."""
    while True:
        around = [n for n in (at, at - 1, at + 1) if 0 <= n < len(heights)]
        best = min(around, key=lambda n: float(heights[n]))
        if heights[best] >= heights[at] - 1e-7:
            return at
        at = best


def _rest_heights(underside: Underside, support: Support, x_m: NDArray[np.float64]) -> NDArray[np.float64]:
    lifted: NDArray[np.float64] = _lifts(
        underside.lowest_m, underside.first_m + x_m, support.height_m, support.period_m
    )
    return np.asarray(np.maximum(lifted, -underside.lowest_m.min() - LARGEST_SINK * underside.height_m), np.float64)


def typical_sink_m(support: Support, axes_mm: tuple[float, float, float] = MEAN_AXES_MM) -> float:
    """How far the underside of a flat ellipsoid of these axes lies below z = 0, settled, in the mean of 12 headings."""
    directions, faces = icosphere(3)
    body = directions * (np.array(axes_mm) / 2000)
    sinks = []
    for n in range(12):
        turned = body @ rotation_about(np.array([0.0, 0.0, 1.0]), np.pi * n / 12).T
        underside = underside_of(turned, faces)
        _, z = settled(underside, support, support.period_m * n / 12)
        sinks.append(-(z + float(turned[:, 2].min())))
    return float(np.mean(sinks))


@kernel(nogil=True)
def _lower_edges(
    x: NDArray[np.float64], z: NDArray[np.float64], faces: NDArray[np.int32], first: float, lowest: NDArray[np.float64]
) -> None:
    for f in range(faces.shape[0]):
        for e in range(3):
            a, b = faces[f, e], faces[f, (e + 1) % 3]
            if a > b:  # a closed mesh has each edge twice
                continue
            if x[a] > x[b]:
                a, b = b, a
            low = max(0, int(np.ceil((x[a] - first) / STEP_M)))
            high = min(len(lowest) - 1, int(np.floor((x[b] - first) / STEP_M)))
            slope = (z[b] - z[a]) / (x[b] - x[a]) if x[b] > x[a] else 0.0
            for i in range(low, high + 1):
                at = z[a] + slope * (first + i * STEP_M - x[a])
                if at < lowest[i]:
                    lowest[i] = at


@kernel(nogil=True)
def _lifts(
    lowest: NDArray[np.float64], firsts: NDArray[np.float64], height: NDArray[np.float64], period: float
) -> NDArray[np.float64]:
    """For each first x: max of support minus underside; the support is linear between its samples."""
    count = len(height)
    out = np.empty(len(firsts))
    for n in range(len(firsts)):
        best = -np.inf
        for i in range(len(lowest)):
            at = (firsts[n] + i * STEP_M) / period
            at = (at - np.floor(at)) * count
            left = int(at) % count
            right = (left + 1) % count
            if height[left] == -np.inf or height[right] == -np.inf:
                continue
            share = at - np.floor(at)
            gap = (1 - share) * height[left] + share * height[right] - lowest[i]
            if gap > best:
                best = gap
        out[n] = best
    return out
