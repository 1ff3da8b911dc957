"""A stereo camera whose depth is matched: two images of textured bodies and belt, and OpenCV's matcher over them.

`stereo` draws what such a camera does wrong afresh in each frame. Here it follows from what is seen: where texture,
slope and the parts of a pixel are the same, the error is the same again, so it stays on the skin; a window that reaches
over an outline takes the nearer surface with it and raises flanks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from camera_sim.sim.optics import BASELINE_M
from camera_sim.sim.raster import Canvas, Window
from conveyor.geometry import Intrinsics
from conveyor.kernels import kernel

FINER = 2
"""Images are matched on so many times their rows and columns: steps of disparity are 1/32 px, as a D405's."""
PAD_PX = 28
"""What is drawn at least around the window that is asked for: a matcher needs what lies beside it, and the image's rim,
too. It sees nothing as far from the left as the disparities are that it looks for."""
STEP = 16
"""The matcher looks for a multiple of so many fine disparities."""
MOST_APART = 2.0
"""Fine disparities of one pixel that differ by more than this are no match."""
LATTICE = 48
OCTAVES = (1.0, 2.9)
"""Sizes of the marks on skin and belt, in units of the smallest."""
BELT_LIGHT, SKIN_LIGHT = 75.0, (105.0, 175.0)
"""Grey levels where a surface faces up; each body has its own."""
STEEPEST = 0.4
"""Of its light that a surface on edge keeps."""


@dataclass(frozen=True, slots=True)
class Matching:
    """One stereo camera, its matcher, and the marks that it finds to match.

    Attributes:
        baseline_m: between its imagers.
        window_px: side of the window that is compared, fine rows and columns; odd.
        semi_global: `StereoSGBM`, which closes flanks; else `StereoBM`, which loses what is steep.
        unlike_percent: by how much the best match must beat the second best.
        contrast: standard deviation of the marks, share of the grey level. noise: of an image, grey levels of 255.
        mark_px: size of the smallest marks on the belt, pixels; finer ones cannot be told apart.
        texture: seed of the marks.
    """

    baseline_m: float = BASELINE_M
    window_px: int = 15
    semi_global: bool = False
    unlike_percent: int = 8
    contrast: float = 0.2
    noise: float = 2.0
    mark_px: float = 1.6
    texture: int = 0


def matched(
    show: Callable[[float, Window], Canvas],
    own_from_camera: NDArray[np.float64],
    *,
    up: NDArray[np.float64],
    belt_m: float,
    intrinsics: Intrinsics,
    window: Window,
    unit_m: float,
    matching: Matching,
    rng: Generator,
) -> NDArray[np.uint16]:
    """(h, w) uint16 depth of `window` in units of `unit_m`, 0 = none.

    Args:
        show: draws what the imager that many metres to the right of the camera sees of a window, ids from 0 on.
        own_from_camera: (n, 4, 4) for each id the frame that its marks are fixed to.
        up: (3,) away from the belt, in the camera's frame. belt_m: about how far that is. rng: of the images' noise.
    """
    strength, pad = intrinsics.fx * matching.baseline_m, PAD_PX
    padded = _padded(window, pad)
    left = show(0.0, padded)
    near, far = strength * float(left.inverse_depth.max()), strength * float(left.inverse_depth.min())
    shift = int(far) - 2  # the right image begins so much farther left, so that disparities begin near 2
    disparities = STEP * max(1, int(np.ceil((FINER * (near - shift) + 8) / STEP)))
    if (disparities + matching.window_px) // FINER >= pad:
        pad = (disparities + matching.window_px) // FINER + 1
        padded = _padded(window, pad)
        left = show(0.0, padded)
    right = show(matching.baseline_m, Window(padded.u0 - shift, padded.v0, padded.height, padded.width))
    aside = np.eye(4)
    aside[0, 3] = matching.baseline_m
    smallest_m = matching.mark_px * belt_m / intrinsics.fx
    images = [
        _image(canvas, own, up, intrinsics, smallest_m, matching, rng)
        for canvas, own in ((left, own_from_camera), (right, own_from_camera @ aside))
    ]
    found = _disparity(images[0], images[1], matching, disparities)
    inside = np.s_[pad : pad + window.height, pad : pad + window.width]
    disparity = np.where(found > 0, found + shift, 0)[inside]
    columns = np.arange(window.u0, window.u0 + window.width)[None, :]
    seen = (disparity > 0.5) & (columns - disparity >= 0)
    units = np.rint(strength / np.where(seen, disparity, 1.0) / unit_m)
    return np.where(seen & (units < 65535), units, 0).astype(np.uint16)


def _padded(window: Window, pad: int) -> Window:
    return Window(window.u0 - pad, window.v0 - pad, window.height + 2 * pad, window.width + 2 * pad)


def _image(
    canvas: Canvas,
    own: NDArray[np.float64],
    up: NDArray[np.float64],
    k: Intrinsics,
    smallest_m: float,
    matching: Matching,
    rng: Generator,
) -> NDArray[np.uint8]:
    """(h, w) grey levels of what one imager sees."""
    rng_of_marks = np.random.default_rng([matching.texture, 1])
    lights = np.concatenate([[BELT_LIGHT], rng_of_marks.uniform(*SKIN_LIGHT, len(own) - 1)])
    pinhole = (k.fx, k.fy, k.cx - canvas.window.u0, k.cy - canvas.window.v0)
    sizes = smallest_m * np.array(OCTAVES)
    light = _lit(
        canvas.inverse_depth,
        canvas.ids,
        np.ascontiguousarray(own),
        up,
        pinhole,
        _marks(matching.texture),
        sizes,
        matching.contrast,
        lights,
    )
    noise = rng.standard_normal(light.shape, dtype=np.float32) * np.float32(matching.noise)
    return np.asarray(np.clip(np.rint(light + noise), 0, 255), np.uint8)


def _disparity(
    left: NDArray[np.uint8], right: NDArray[np.uint8], matching: Matching, disparities: int
) -> NDArray[np.float64]:
    """(h, w) disparity in pixels, 0 where nothing matches; so many fine ones are looked for."""
    fine = [cv2.resize(image, None, fx=FINER, fy=FINER, interpolation=cv2.INTER_CUBIC) for image in (left, right)]
    stereo: cv2.StereoMatcher
    if matching.semi_global:
        window = max(5, 2 * matching.window_px // 3 | 1)
        stereo = cv2.StereoSGBM.create(
            P1=2 * window**2,
            P2=12 * window**2,
            uniquenessRatio=matching.unlike_percent,
            mode=cv2.StereoSGBM_MODE_SGBM_3WAY,
        )
        stereo.setBlockSize(window)
    else:
        stereo = windows = cv2.StereoBM.create()
        windows.setUniquenessRatio(matching.unlike_percent)
        stereo.setBlockSize(matching.window_px)
    stereo.setMinDisparity(0)
    stereo.setNumDisparities(disparities)
    stereo.setDisp12MaxDiff(2)
    stereo.setSpeckleWindowSize(80)
    stereo.setSpeckleRange(2)
    steps = np.asarray(stereo.compute(fine[0], fine[1]), np.float32) / 16
    parts = [steps[v::FINER, u::FINER] for v in range(FINER) for u in range(FINER)]
    least, most_of = np.minimum.reduce(parts), np.maximum.reduce(parts)
    seen = (least > 0) & (most_of - least < MOST_APART)
    return np.where(seen, sum(parts) / len(parts) / FINER, 0.0).astype(np.float64)


@lru_cache(maxsize=4)
def _marks(texture: int) -> NDArray[np.float32]:
    """(n, n, n) unit normal numbers that marks are interpolated from."""
    rng = np.random.default_rng([texture, 0])
    return rng.standard_normal((LATTICE, LATTICE, LATTICE), dtype=np.float32)


@kernel(nogil=True)
def _lit(
    inverse_depth: NDArray[np.float32],
    ids: NDArray[np.int32],
    own: NDArray[np.float64],
    up: NDArray[np.float64],
    pinhole: tuple[float, float, float, float],
    marks: NDArray[np.float32],
    sizes: NDArray[np.float64],
    contrast: float,
    lights: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Grey levels (h, w): brighter the more a surface faces up, with marks that are fixed to its own frame."""
    height, width = inverse_depth.shape
    fx, fy, cx, cy = pinhole
    out = np.empty((height, width), np.float32)
    for v in range(height):
        for u in range(width):
            which = ids[v, u]
            z = 1.0 / inverse_depth[v, u]
            x, y = (u - cx) / fx * z, (v - cy) / fy * z
            # A neighbour on the same body, where there is one.
            du = -1 if u == width - 1 or (u > 0 and ids[v, u + 1] != which) else 1
            dv = -1 if v == height - 1 or (v > 0 and ids[v + 1, u] != which) else 1
            za, zb = 1.0 / inverse_depth[v, u + du], 1.0 / inverse_depth[v + dv, u]
            ax, ay, az = (u + du - cx) / fx * za - x, (v - cy) / fy * za - y, za - z
            bx, by, bz = (u - cx) / fx * zb - x, (v + dv - cy) / fy * zb - y, zb - z
            nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            norm = np.sqrt(nx * nx + ny * ny + nz * nz)
            upwards = abs(nx * up[0] + ny * up[1] + nz * up[2]) / norm if norm > 0 else 1.0
            m = own[which]
            px = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
            py = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
            pz = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
            total = 0.0
            for octave in range(len(sizes)):
                size = sizes[octave]
                total += _mark(marks, px / size + 7.3 * which, py / size + 3.1 * octave, pz / size)
            out[v, u] = lights[which] * (STEEPEST + (1 - STEEPEST) * upwards) * (1 + contrast * total)
    return out


@kernel(nogil=True)
def _mark(marks: NDArray[np.float32], x: float, y: float, z: float) -> float:
    """Between the eight lattice points around a place, with about the same spread everywhere."""
    side = marks.shape[0]
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    fx, fy, fz = x - i, y - j, z - k
    total, squares = 0.0, 0.0
    for a in range(2):
        for b in range(2):
            for c in range(2):
                share = (fx if a else 1 - fx) * (fy if b else 1 - fy) * (fz if c else 1 - fz)
                total += share * marks[(i + a) % side, (j + b) % side, (k + c) % side]
                squares += share * share
    found: float = total / np.sqrt(3 * squares)
    return found
