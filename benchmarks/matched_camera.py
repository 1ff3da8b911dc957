"""A camera whose depth is matched: two images of textured bodies and belt, and OpenCV's stereo matcher over them.

What a depth camera does wrong is not drawn here from any distribution: noise, steps, lost and grown outlines, islands
and holes are what matching makes of two images.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numba
import numpy as np

from benchmarks.otherworld_camera import Bodies, Camera, Sensor, View, bare_m, draw_bodies

FINER = 2
"""Pixels are means of so many by so many rays; matching is done on rows and columns so much finer."""
GRAINS_M = (0.0009, 0.0023, 0.0061)
"""Sizes of the grains that the texture of skin and belt is made of."""
BELT_LIGHT, BODY_LIGHT = 70.0, 150.0
"""Grey levels of the belt and of what lies on it, lit from straight above."""
HIGHEST_M = 0.13
"""The matcher looks for surfaces up to so far above the belt."""


@dataclass(frozen=True, slots=True)
class Matcher:
    """Two imagers side by side and what is made of their images.

    Attributes:
        baseline_m: between the imagers. unit_m: of the depth that is written.
        window_px: side of the window that is compared, in fine rows and columns; odd. 15 are 7.5 pixels.
        contrast: sd of the texture, as a share of the grey level. noise: sd of an image's noise, grey levels of 255.
        semi_global: OpenCV's `StereoSGBM`, which closes flanks and sees steps; else its `StereoBM`, which compares
            windows alone and loses what is steep.
        unlike_percent: by how much the best match must beat the second best.
    """

    baseline_m: float = 0.018
    unit_m: float = 0.0001
    window_px: int = 15
    contrast: float = 0.25
    noise: float = 2.0
    semi_global: bool = False
    unlike_percent: int = 8

    def view(self, camera: Camera, rng: np.random.Generator) -> MatchedView:
        """Before a camera; `rng` draws the texture and the images' noise."""
        return MatchedView(camera, self, rng)


class MatchedView(View):
    """A camera with two imagers; the left one is the camera."""

    def __init__(self, camera: Camera, matcher: Matcher, rng: np.random.Generator) -> None:
        super().__init__(camera, Sensor(unit_m=matcher.unit_m), rng)
        self.matcher = matcher
        self._grain = np.asarray(rng.normal(size=(64, 64, 64)), np.float32)
        scale = FINER * camera.focal_px * matcher.baseline_m
        bare = scale / self._belt_m
        self._least = int(bare.min()) - 4
        most = (scale / (self._belt_m - HIGHEST_M)).max()
        self._span = 16 * int(np.ceil((most - self._least) / 16))

    def measured(
        self,
        depth_m: np.ndarray,
        label: np.ndarray,
        bodies: Bodies = (),
        travel_m: float = 0.0,
    ) -> np.ndarray:
        """uint16 (H, W) in `unit_m`, 0 = no depth, by the two imagers alone.

        Args:
            bodies: as `exact` takes them. travel_m: of the belt; the texture rides with it.
        """
        left, right = (self._image(aside_m, bodies, travel_m) for aside_m in (0.0, self.matcher.baseline_m))
        disparity = self._matched(left, right)
        scale = self.camera.focal_px * self.matcher.baseline_m
        units = np.rint(scale / np.maximum(disparity, 0.5) / self.matcher.unit_m)
        return np.where(disparity > 0, np.clip(units, 0, 65535), 0).astype(np.uint16)

    def _image(self, aside_m: float, bodies: Bodies, travel_m: float) -> np.ndarray:
        """What the imager `aside_m` to the right of the camera sees: uint8 (H, W)."""
        camera, matcher = self.camera, self.matcher
        pose = camera.belt_from_camera
        pose[:3, 3] += pose[:3, 0] * aside_m
        focal = FINER * camera.focal_px
        cx, cy = (FINER * centre + (FINER - 1) / 2 for centre in camera.centre_px)
        depth_m = bare_m(FINER * camera.height, FINER * camera.width, pose, focal, cx, cy)
        label = draw_bodies(depth_m, bodies, pose, focal, cx, cy)
        light = lit(depth_m, label, pose, focal, cx, cy, travel_m, self._grain, matcher.contrast)
        image = cv2.resize(light, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
        noise = self.rng.normal(size=image.shape) * matcher.noise
        return np.asarray(np.clip(np.rint(image + noise), 0, 255), np.uint8)

    def _matched(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Disparity (H, W) in pixels of the camera; 0 where no match was found."""
        matcher = self.matcher
        fine = [cv2.resize(image, None, fx=FINER, fy=FINER, interpolation=cv2.INTER_CUBIC) for image in (left, right)]
        stereo: cv2.StereoMatcher
        if matcher.semi_global:
            stereo = cv2.StereoSGBM.create(
                P1=matcher.window_px**2,
                P2=8 * matcher.window_px**2,
                uniquenessRatio=matcher.unlike_percent,
                mode=cv2.StereoSGBM_MODE_SGBM_3WAY,
            )
        else:
            stereo = windows = cv2.StereoBM.create()
            windows.setUniquenessRatio(matcher.unlike_percent)
        stereo.setMinDisparity(self._least)
        stereo.setNumDisparities(self._span)
        stereo.setBlockSize(matcher.window_px)
        stereo.setDisp12MaxDiff(2)
        stereo.setSpeckleWindowSize(60)
        stereo.setSpeckleRange(2)
        found = stereo.compute(*fine).astype(np.float32) / 16
        rows, columns = left.shape
        parts = found.reshape(rows, FINER, columns, FINER).swapaxes(1, 2).reshape(rows, columns, FINER * FINER)
        seen = (parts >= self._least).all(2) & (np.ptp(parts, axis=2) < 2)
        return np.where(seen, parts.mean(2) / FINER, 0)


@numba.njit(cache=True)
def lit(depth_m, label, pose, focal, cx, cy, travel_m, grain, contrast):  # type: ignore[no-untyped-def]
    """Grey levels, float32 (H, W): brighter the more a surface faces up, with a texture that is fixed to it."""
    height, width = depth_m.shape
    light = np.empty((height, width), np.float32)
    for v in range(height):
        for u in range(width):
            here = _on_belt(depth_m, u, v, pose, focal, cx, cy)
            aside = _on_belt(depth_m, u + 1 if u + 1 < width else u - 1, v, pose, focal, cx, cy)
            below = _on_belt(depth_m, u, v + 1 if v + 1 < height else v - 1, pose, focal, cx, cy)
            ax, ay, az = aside[0] - here[0], aside[1] - here[1], aside[2] - here[2]
            bx, by, bz = below[0] - here[0], below[1] - here[1], below[2] - here[2]
            nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            up = abs(nz) / np.sqrt(nx * nx + ny * ny + nz * nz)
            marks = 0.0
            for size in GRAINS_M:
                marks += _grain_at(grain, (here[0] - travel_m) / size, here[1] / size, here[2] / size)
            level = (BELT_LIGHT if label[v, u] == 0 else BODY_LIGHT) * (0.35 + 0.65 * up)
            light[v, u] = level * (1 + contrast * marks)
    return light


@numba.njit(cache=True, inline="always")
def _on_belt(depth_m, u, v, pose, focal, cx, cy):  # type: ignore[no-untyped-def]
    z = depth_m[v, u]
    x, y = (u - cx) / focal * z, (v - cy) / focal * z
    return (
        pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3],
        pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3],
        pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3],
    )


@numba.njit(cache=True, inline="always")
def _grain_at(grain, x, y, z):  # type: ignore[no-untyped-def]
    """Between the eight grains around a place, with about the same sd everywhere."""
    side = grain.shape[0]
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    fx, fy, fz = x - i, y - j, z - k
    total, squares = 0.0, 0.0
    for a in range(2):
        for b in range(2):
            for c in range(2):
                share = (fx if a else 1 - fx) * (fy if b else 1 - fy) * (fz if c else 1 - fz)
                total += share * grain[(i + a) % side, (j + b) % side, (k + c) % side]
                squares += share * share
    return total / np.sqrt(3 * squares)
