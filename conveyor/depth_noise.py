"""Local noise of a depth image: what is left of small windows beside the quadric through them, in disparity.

A skin or a belt is smooth over 11 pixels; what departs from a quadric there is the camera's. Disparity and not depth,
because a stereo camera's error is one of disparity: the same share of a pixel near and far.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from conveyor.camera_range import BASELINE_M
from conveyor.kernels import kernel

SIDE = 11
"""Pixels along a window. Real and simulated cameras are compared with this window (docs/worlds.md)."""
LEAST_SEEN = 0.5
"""Share of a window that must have depth. All of it would leave out what lies beside holes, which is noisier."""
JUMP_PX = 1.0
"""Disparity between neighbours from which on a window lies across an outline and says nothing of the noise."""
STRIDE, QUICK_STRIDE = 7, 33
"""Pixels between windows, and between those of a quick look: 350 windows of an image of 848x480, some 5 ms."""
LEAST_WINDOWS = 40
"""Fewer windows have no middle worth the name."""
CROP_WINDOWS, LEAST_CROP_WINDOWS = 48, 6
"""Windows looked at on one tuber, about, and how few say something: 48 take under a millisecond and know the noise to
5 %; a small tuber far away has 20."""

PLACES = np.arange(SIDE) / (SIDE // 2) - 1.0
"""(11,) of the pixels along a window, -1 to 1."""
_Y, _X = np.meshgrid(PLACES, PLACES, indexing="ij")
_TERMS = np.stack([np.ones((SIDE, SIDE)), _X, _Y, _X * _X, _X * _Y, _Y * _Y]).reshape(6, -1)
WHOLE = _TERMS @ _TERMS.T + 1e-9 * np.eye(6)
"""(6, 6) normal equations of a quadric through a window that is seen whole, with a little ridge."""

Disparity = NDArray[np.float32]


def disparity(depth: NDArray[np.uint16], *, depth_scale_m: float, focal_baseline: float) -> Disparity:
    """(h, w) float32 disparity in pixels, 0 where there is no depth.

    Args:
        depth: (h, w) uint16, units of `depth_scale_m` metres, 0 = no depth.
        focal_baseline: focal length in pixels times the distance of the imagers in metres.
    """
    table = np.zeros(int(depth.max()) + 1, np.float32)
    table[1:] = focal_baseline / depth_scale_m / np.arange(1, len(table))
    return np.asarray(table[depth], np.float32)


def window_residuals_px(d: Disparity, *, stride: int = STRIDE) -> NDArray[np.float64]:
    """(n,) standard deviation about its quadric of each window that lies on one surface.

    Args:
        d: (h, w) disparity in pixels, 0 = none.
        stride: pixels between windows, both ways.
    """
    if min(d.shape) < SIDE:
        return np.zeros(0)
    found: NDArray[np.float64] = _residuals(_windows(d, stride))
    return found


def noise_px(d: Disparity, *, stride: int = QUICK_STRIDE) -> float | None:
    """The median of `window_residuals_px`; None where too little surface shows."""
    found = window_residuals_px(d, stride=stride)
    return float(np.median(found)) if len(found) >= LEAST_WINDOWS else None


def crop_noise_px(
    depth: NDArray[np.uint16], *, depth_scale_m: float, fx: float, baseline_m: float = BASELINE_M
) -> float | None:
    """Local noise on one tuber's skin, pixels of disparity; None where too little of it shows.

    Args:
        depth: (h, w) uint16, units of `depth_scale_m` metres, zero outside the tuber. fx: focal length, pixels.
        baseline_m: distance of the imagers whose pixels are meant.
    """
    tuber, count = _tuber(np.ascontiguousarray(depth), fx * baseline_m / depth_scale_m)
    if not count:
        return None
    stride = max(STRIDE, int(np.sqrt(count / CROP_WINDOWS)))
    found = window_residuals_px(tuber, stride=stride)
    return float(np.median(found)) if len(found) >= LEAST_CROP_WINDOWS else None


def neighbour_steps_px(d: Disparity) -> NDArray[np.float32]:
    """(n,) how far neighbours that both have depth lie apart, along rows and along columns."""
    steps = []
    for one, other in ((d[1:], d[:-1]), (d[:, 1:], d[:, :-1])):
        both = (one > 0) & (other > 0)
        steps.append(np.abs(one[both] - other[both]))
    return np.concatenate(steps)


@kernel(nogil=True, error_model="numpy")
def _tuber(depth: NDArray[np.uint16], strength: float) -> tuple[Disparity, int]:
    """Disparity of a crop without the bare rows and columns at its ends, and how many of its pixels have depth.

    Windows are counted from the tuber's own first pixel: the same in a crop as in the whole image.
    """
    rows, columns = depth.shape
    top, bottom, left, right, count = rows, 0, columns, 0, 0
    for v in range(rows):
        for u in range(columns):
            if depth[v, u] > 0:
                top, bottom = min(top, v), max(bottom, v + 1)
                left, right = min(left, u), max(right, u + 1)
                count += 1
    found = np.zeros((max(0, bottom - top), max(0, right - left)), np.float32)
    for v in range(found.shape[0]):
        for u in range(found.shape[1]):
            d = depth[top + v, left + u]
            if d > 0:
                found[v, u] = np.float32(strength / d)
    return found, count


@kernel(nogil=True)
def _windows(d: Disparity, stride: int) -> NDArray[np.float64]:
    """(n, 121) every window of which enough is seen, and no two neighbours lie a jump apart, in raster order."""
    rows, columns = (d.shape[0] - SIDE) // stride + 1, (d.shape[1] - SIDE) // stride + 1
    windows = np.empty((rows * columns, SIDE * SIDE))
    n = 0
    for row in range(rows):
        for column in range(columns):
            if _smooth(d[row * stride : row * stride + SIDE, column * stride : column * stride + SIDE], windows[n]):
                n += 1
    return windows[:n]


@kernel(nogil=True)
def _smooth(window: Disparity, out: NDArray[np.float64]) -> bool:
    """Copy a window, row by row; False where too little of it is seen or it lies across an outline."""
    seen = 0
    for v in range(SIDE):
        for u in range(SIDE):
            here = window[v, u]
            out[v * SIDE + u] = here
            if here <= 0:
                continue
            seen += 1
            if u > 0 and window[v, u - 1] > 0 and abs(here - window[v, u - 1]) >= JUMP_PX:
                return False
            if v > 0 and window[v - 1, u] > 0 and abs(here - window[v - 1, u]) >= JUMP_PX:
                return False
    return seen >= LEAST_SEEN * SIDE * SIDE


@kernel(nogil=True, error_model="numpy")
def _residuals(windows: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) standard deviation of what is seen of (n, 121) windows, 0 = not seen, about the quadric through it."""
    found = np.empty(len(windows))
    for n in range(len(windows)):
        normal, right, middle, count = _equations(windows[n])
        c = _solved(normal, right)
        square = 0.0
        for v in range(SIDE):
            y = PLACES[v]
            level, slope = c[0] + y * (c[2] + y * c[5]) + middle, c[1] + y * c[4]
            for u in range(SIDE):
                d, x = windows[n, v * SIDE + u], PLACES[u]
                left = d - (level + x * (slope + x * c[3])) if d > 0 else 0.0
                square += left * left
        found[n] = np.sqrt(square / (count - 6))
    return found


@kernel(nogil=True, error_model="numpy")
def _equations(window: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64], float, int]:
    """(6, 6) and (6,) for the terms 1, x, y, xx, xy, yy of what is seen of a window, with a little ridge; its mean,
    which is taken off; how many pixels are seen. Sums over the pixels are those of all less those not seen.
    """
    total, normal, right, terms = window.sum(), WHOLE.copy(), np.zeros(6), np.ones(6)
    count = SIDE * SIDE
    for i in range(SIDE * SIDE):
        if window[i] == 0:
            x, y = PLACES[i % SIDE], PLACES[i // SIDE]
            terms[1], terms[2], terms[3], terms[4], terms[5] = x, y, x * x, x * y, y * y
            for p in range(6):
                for q in range(p + 1):
                    normal[p, q] -= terms[p] * terms[q]
            count -= 1
    middle = total / count
    for v in range(SIDE):
        y, once, by_x, by_xx = PLACES[v], 0.0, 0.0, 0.0
        for u in range(SIDE):
            d, x = window[v * SIDE + u], PLACES[u]
            d = d - middle if d > 0 else 0.0
            once, by_x, by_xx = once + d, by_x + d * x, by_xx + d * x * x
        for p, value in enumerate((once, by_x, y * once, by_xx, y * by_x, y * y * once)):
            right[p] += value
    return normal, right, middle, count


@kernel(nogil=True, error_model="numpy")
def _solved(normal: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    """(6,) solution of equations whose lower triangle is given, by Cholesky's factors, in place."""
    for p in range(6):
        for q in range(p + 1):
            rest = normal[p, q]
            for k in range(q):
                rest -= normal[p, k] * normal[q, k]
            normal[p, q] = np.sqrt(rest) if p == q else rest / normal[q, q]
        for k in range(p):
            right[p] -= normal[p, k] * right[k]
        right[p] /= normal[p, p]
    for p in range(5, -1, -1):
        for k in range(p + 1, 6):
            right[p] -= normal[k, p] * right[k]
        right[p] /= normal[p, p]
    return right
