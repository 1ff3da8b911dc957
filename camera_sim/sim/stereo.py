"""What a passive stereo camera makes of a true depth image.

Errors are made where they arise, in the disparity d = f B / z: a matching window that blurs edges into flying pixels,
ragged edges, smooth and fine noise, 1/32 px steps, holes in the right imager's shadow, on steep flanks and where
there is no texture. Strengths follow two real D405 clouds of 3DPotatoTwin: fine noise beside the rounding below 0.2 mm,
smooth error of 0.5-1 mm (median distance to the complete tuber 0.67 mm at 0.345 m and 0.95 mm at 0.465 m).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.special import ndtri

from camera_sim.sim.optics import BASELINE_M
from camera_sim.sim.stereo_faults import add_islands, lost_outlines
from conveyor.kernels import kernel

Field = NDArray[np.float32]
STEPS_PER_PIXEL = 32
BLUR_PX = 1.6


@dataclass(frozen=True, slots=True)
class StereoNoise:
    """How bad the camera is. Standard deviations in pixels of disparity, 1 = the real D405 for the two factors.

    Attributes:
        fine_px: independent from pixel to pixel; mid_px: correlated over a few pixels (the matching window).
        smooth_px: correlated over 10-20 pixels.
        edge_px: how far edges wander.
        steep: disparity change per pixel above which matching tends to fail.
        bare: share of the surface without texture to match.
        steps_per_px: disparity is a multiple of one of so many parts of a pixel.
        bow_px: standard deviation over the field of view of an error that is the same in every frame.
        drift_px: what every disparity is too large by; scale: what every depth is too large by, as a factor.
        islands: false matches per megapixel; island_px: by how much they are off, smallest and largest.
        rim_px, outline_px: width of the holes at outlines, on the nearer and on the farther surface's side.
        blob_px: size of the spots without texture, 2 or 5. blur_px: of the matching window, sigma; 0 blurs nothing.
    """

    fine_px: float = 0.010
    mid_px: float = 0.012
    smooth_px: float = 0.060
    edge_px: float = 1.1
    steep: float = 0.55
    bare: float = 0.0003
    steps_per_px: int = STEPS_PER_PIXEL
    bow_px: float = 0.0
    drift_px: float = 0.0
    scale: float = 1.0
    islands: float = 0.0
    island_px: tuple[float, float] = (5.0, 50.0)
    rim_px: float = 0.0
    outline_px: float = 0.0
    blob_px: int = 2
    blur_px: float = BLUR_PX

    def seen_m(self, depth_m: float, *, focal_px: float) -> float:
        """What this camera takes the depth `depth_m` for, without noise, metres."""
        strength = focal_px * BASELINE_M
        return self.scale * strength / (strength / depth_m + self.drift_px)

    def true_m(self, seen_m: float, *, focal_px: float) -> float:
        """The depth that it takes for `seen_m`, metres."""
        strength = focal_px * BASELINE_M
        return strength / (self.scale * strength / seen_m - self.drift_px)


EASY = StereoNoise()
EXACT = StereoNoise(fine_px=0.0, mid_px=0.0, smooth_px=0.0, edge_px=0.0, steep=float("inf"), bare=0.0, blur_px=0.0)
"""Nothing but steps of disparity, rounding, and what the right imager does not see."""
FIELD = StereoNoise(fine_px=0.015, mid_px=0.018, smooth_px=0.085, edge_px=1.6, steep=0.5, bare=0.001)


class NoiseBank:
    """Noise fields larger than the image, made once; each frame takes them at random offsets, so any frame is cheap.

    Fields are (h + SPARE, w + SPARE) float32 of unit variance.
    """

    SPARE = 128

    def __init__(self, rng: Generator, *, height: int, width: int) -> None:
        size = (height + self.SPARE, width + self.SPARE)
        self.white = rng.standard_normal(size, dtype=np.float32)
        self.mid = _smoothed(rng, size, sigma_px=2.5)
        self.smooth = _coarse(rng, size, sigma_px=14.0)
        self.edge = _smoothed(rng, size, sigma_px=5.0)
        self.texture = _smoothed(rng, size, sigma_px=2.0)

    def take(self, field: Field, rng: Generator, height: int, width: int) -> Field:
        """A (height, width) part of `field` at a random offset."""
        dv, du = (int(n) for n in rng.integers(0, self.SPARE, 2))
        return field[dv : dv + height, du : du + width]


def measure(
    depth_m: Field,
    *,
    focal_px: float,
    unit_m: float,
    noise: StereoNoise,
    bank: NoiseBank,
    rng: Generator,
    left_border: bool = True,
    bow: Field | None = None,
) -> NDArray[np.uint16]:
    """(h, w) uint16 depth in units of `unit_m`, 0 = none, from the true depth (h, w) in metres.

    Args:
        left_border: the image's first column is the sensor's; what lies left of it is missing in the right imager.
        bow: (h, w) float32 of unit variance, the part of the camera's bowed field that is looked at.
    """
    height, width = depth_m.shape
    strength = focal_px * BASELINE_M
    true = (strength / depth_m).astype(np.float32)
    d = _wander(true, noise.edge_px, bank, rng)
    if noise.blur_px > 0:
        d = _as_field(cv2.GaussianBlur(d, (0, 0), noise.blur_px))
    steepness = _steepness(d)
    worse = 1 + np.float32(2.5) * np.minimum(steepness, np.float32(2))
    d = d + np.float32(noise.fine_px) * bank.take(bank.white, rng, height, width) * worse
    d += np.float32(noise.mid_px) * bank.take(bank.mid, rng, height, width) * worse
    d += np.float32(noise.smooth_px) * bank.take(bank.smooth, rng, height, width)
    texture = bank.take(bank.texture, rng, height, width)
    bare = bank.take(bank.edge if noise.blob_px > 2 else bank.texture, rng, height, width)
    if bow is not None:
        d += np.float32(noise.bow_px) * bow
    if noise.drift_px:
        d += np.float32(noise.drift_px)
    if noise.islands > 0:
        add_islands(d, per_megapixel=noise.islands, offset_px=noise.island_px, rng=rng)
    out = _to_units(
        d,
        true,
        steepness,
        texture,
        bare,
        float(noise.steep),
        float(_upper_quantile(noise.bare)),
        noise.scale * strength / unit_m,
        left_border,
        float(noise.steps_per_px),
    )
    if noise.rim_px > 0 or noise.outline_px > 0:
        wander = bank.take(bank.edge, rng, height, width)
        out[lost_outlines(true, wander, near_px=noise.rim_px, far_px=noise.outline_px)] = 0
    return np.asarray(out, np.uint16)


def _wander(true: Field, edge_px: float, bank: NoiseBank, rng: Generator) -> Field:
    """The image with its edges displaced by smooth random amounts: nothing changes where depth is flat."""
    height, width = true.shape
    columns, rows = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    du = columns + np.float32(edge_px) * bank.take(bank.edge, rng, height, width)
    dv = rows + np.float32(edge_px) * bank.take(bank.edge, rng, height, width)
    return _as_field(cv2.remap(true, du, dv, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE))


def _steepness(d: Field) -> Field:
    du = cv2.Sobel(d, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    dv = cv2.Sobel(d, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8)
    return _as_field(cv2.magnitude(du, dv))


def _smoothed(rng: Generator, size: tuple[int, int], *, sigma_px: float) -> Field:
    field = cv2.GaussianBlur(rng.standard_normal(size, dtype=np.float32), (0, 0), sigma_px)
    return _as_field(field / field.std())


def _coarse(rng: Generator, size: tuple[int, int], *, sigma_px: float) -> Field:
    """Smooth noise made at a quarter of the resolution."""
    small = _smoothed(rng, (size[0] // 4 + 8, size[1] // 4 + 8), sigma_px=sigma_px / 4)
    large = cv2.resize(small, None, fx=4, fy=4, interpolation=cv2.INTER_CUBIC)[: size[0], : size[1]]
    return _as_field(large / large.std())


def _upper_quantile(share: float) -> float:
    """Value that a unit normal exceeds with probability `share`; infinity for 0."""
    return float(-ndtri(share)) if share > 0 else float("inf")


def _as_field(array: Any) -> Field:
    return np.asarray(array, np.float32)


@kernel(nogil=True)
def _to_units(
    d: Field,
    true: Field,
    steepness: Field,
    texture: Field,
    bare: Field,
    steep: float,
    bare_above: float,
    units: float,
    left_border: bool,
    steps: float,
) -> NDArray[np.uint16]:
    """Quantise, cut holes, and convert to depth units; `units` / d is the depth in units."""
    height, width = d.shape
    out = np.zeros((height, width), np.uint16)
    for v in range(height):
        nearest = 1e9
        for u in range(width - 1, -1, -1):
            seen_at = u - true[v, u]
            hidden = seen_at > nearest + 0.5
            if seen_at < nearest:
                nearest = seen_at
            if hidden or (left_border and seen_at < 0):
                continue
            if steepness[v, u] > steep * max(0.4, 1.0 + 0.35 * texture[v, u]) or bare[v, u] > bare_above:
                continue
            value = np.floor(d[v, u] * steps + 0.5) / steps
            if value <= 0:
                continue
            depth = np.floor(units / value + 0.5)
            if depth < 65535:
                out[v, u] = np.uint16(depth)
    return out
