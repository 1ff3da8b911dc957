"""A plain colour picture of what is seen: skin, soil, stone and stalk under one lamp. For eyes, not for measuring."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from camera_sim.sim.raster import Canvas
from camera_sim.sim.world import World

_BGR = {
    "belt": (52, 50, 48),
    "tuber": (92, 148, 186),
    "clod": (48, 66, 88),
    "stone": (118, 120, 122),
    "haulm": (60, 120, 96),
    "leaf": (50, 110, 70),
}


def paint_jpeg(canvas: Canvas, world: World, rng: Generator) -> NDArray[np.uint8]:
    """(n,) uint8, a JPEG file aligned to the depth image."""
    kinds = ["belt"] + [body.kind for body in sorted(world.bodies, key=lambda body: body.body_id)]
    palette = np.array([_BGR[kind] for kind in kinds], np.float32)
    varied = np.random.default_rng(7).normal(1.0, 0.07, (len(kinds), 1)).astype(np.float32)
    depth = 1 / canvas.inverse_depth
    slope_u = cv2.Sobel(depth, cv2.CV_32F, 1, 0, scale=125.0)
    slope_v = cv2.Sobel(depth, cv2.CV_32F, 0, 1, scale=125.0)
    light = (1.0 + 0.25 * slope_u + 0.25 * slope_v) / np.sqrt(1 + slope_u**2 + slope_v**2)
    grain = 1 + 0.06 * rng.standard_normal(depth.shape, dtype=np.float32)
    image = (palette * varied)[canvas.ids] * (np.clip(light, 0.25, 1.3) * grain)[..., None]
    encoded = cv2.imencode(".jpg", np.clip(image, 0, 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 80])[1]
    return np.asarray(encoded, np.uint8).ravel()
