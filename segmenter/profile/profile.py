"""The profile of a camera: everything measured on a few frames of one recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.camera_range import BASELINE_M
from conveyor.depth_noise import (
    LEAST_WINDOWS,
    Disparity,
    disparity,
    neighbour_steps_px,
    window_residuals_px,
)
from conveyor.errors import InputError
from conveyor.messages import Frame
from segmenter.frame.plane import PlaneFit, fit_plane
from segmenter.profile.comb import KNOWN_BASELINES_M, Comb, find_comb
from segmenter.profile.field import FieldError, field_error
from segmenter.profile.holes import islands, outline_widths_px

LOAD_ABOVE_M = 0.012
"""What stands out from the plane by more is load, and not looked at for the plane's own error; nor what lies so far
below. Less would cut off the error itself: it reaches 0.4 px, some 11 mm at 0.46 m."""
BESIDE_LOAD_PX = 12
FEWEST_OUTLINES = 50
"""Runs across outlines; of fewer no widths are told."""
LARGEST_DEPTH = 1 << 16

Quantiles = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class CameraProfile:
    """What one camera's depth is like. Pixels of disparity are the camera's own.

    Attributes:
        baseline_m: distance of its imagers; `baseline_by` says how: given, found from the steps, or assumed.
        step: the comb of its disparity; None where the depth unit hides it.
        noise_px: 10, 50 and 90 % quantiles of the residual to a quadric of 11 x 11 pixels.
        neighbour_px: 99 and 99.9 % quantiles and maximum of the step between neighbours.
        plane_m: distance of the belt plane; `field` its error; None where no plane is seen.
        outline_px: 50 and 90 % quantiles of the width of holes at outlines, image pixels.
        missing: share of pixels without depth. Of `frames`, as all else; `blank` more had no depth at all.
        island_px: by how much each island of mismatch is off, all frames.
    """

    camera: str
    frames: int
    width: int
    height: int
    depth_scale_m: float
    focal_px: float
    baseline_m: float
    baseline_by: Literal["given", "found", "assumed"]
    step: Comb | None
    noise_px: Quantiles | None
    neighbour_px: Quantiles | None
    plane_m: float | None
    field: FieldError | None
    outline_px: tuple[float, float] | None
    missing: float
    island_px: NDArray[np.float64]
    blank: int

    @property
    def islands_per_frame(self) -> float:
        """Islands of mismatch in a frame."""
        return len(self.island_px) / self.frames

    @property
    def islands_per_megapixel(self) -> float:
        """Islands of mismatch in a million pixels."""
        return 1e6 * self.islands_per_frame / (self.width * self.height)


OnFrame = Callable[[int, int | None], None]


def profile_frames(
    frames: Sequence[Frame], *, baseline_m: float | None = None, on_frame: OnFrame = lambda done, total: None
) -> CameraProfile:
    """The profile of the camera that took `frames`; more frames see more, a dozen spread over a recording is plenty.

    Args:
        on_frame: called with how many frames are measured, and how many there are.

    Raises:
        InputError: there is no frame, or none with depth.
    """
    usable = [frame for frame in frames if frame.depth.any()]
    if not usable:
        raise InputError("no frame with depth: nothing can be measured")
    first = usable[0]
    k = first.intrinsics
    step = _step(usable, baseline_m)
    found = baseline_m or (step.baseline_m if step else BASELINE_M)
    strength = step.focal_baseline if step else k.fx * found
    images = [disparity(f.depth, depth_scale_m=f.depth_scale_m, focal_baseline=strength) for f in usable]
    measured = []
    for n, d in enumerate(images, start=1):
        measured.append((window_residuals_px(d), neighbour_steps_px(d), outline_widths_px(d)))
        on_frame(n, len(images))
    residuals, steps, widths = (np.concatenate(each) for each in zip(*measured, strict=True))
    fits = [fit_plane(f.depth, depth_scale_m=f.depth_scale_m, intrinsics=f.intrinsics, mask=f.mask) for f in usable]
    distances_m = [fit.distance_m for fit in fits if fit is not None]
    return CameraProfile(
        camera=first.camera,
        frames=len(usable),
        width=k.width,
        height=k.height,
        depth_scale_m=first.depth_scale_m,
        focal_px=k.fx,
        baseline_m=found,
        baseline_by="given" if baseline_m else "found" if step else "assumed",
        step=step,
        noise_px=_quantiles(residuals, (0.1, 0.5, 0.9)) if len(residuals) >= LEAST_WINDOWS else None,
        neighbour_px=_quantiles(steps, (0.99, 0.999, 1.0)) if len(steps) else None,
        plane_m=float(np.median(distances_m)) if distances_m else None,
        field=_field(usable, images, fits),
        outline_px=(float(np.quantile(widths, 0.5)), float(np.quantile(widths, 0.9)))
        if len(widths) >= FEWEST_OUTLINES
        else None,
        missing=float(np.mean([np.mean(d == 0) for d in images])),
        island_px=np.concatenate([islands(d).off_px for d in images]),
        blank=len(frames) - len(usable),
    )


def _step(frames: Sequence[Frame], baseline_m: float | None) -> Comb | None:
    counts = np.zeros(LARGEST_DEPTH, np.int64)
    for frame in frames:
        counts += np.bincount(frame.depth.ravel(), minlength=LARGEST_DEPTH)
    baselines = [baseline_m] if baseline_m else list(KNOWN_BASELINES_M.values())
    first = frames[0]
    return find_comb(counts, depth_scale_m=first.depth_scale_m, focal_px=first.intrinsics.fx, baselines_m=baselines)


def _field(frames: Sequence[Frame], images: Sequence[Disparity], fits: Sequence[PlaneFit | None]) -> FieldError | None:
    seen = [
        (d, _on_plane(frame, d, fit)) for frame, d, fit in zip(frames, images, fits, strict=True) if fit is not None
    ]
    return field_error([d for d, _ in seen], [on for _, on in seen])


def _on_plane(frame: Frame, d: Disparity, fit: PlaneFit) -> NDArray[np.bool_]:
    """(h, w) which pixels show the plane, away from everything that stands on it."""
    k = frame.intrinsics
    x = ((np.arange(k.width) - k.cx) / k.fx).astype(np.float32)
    y = ((np.arange(k.height) - k.cy) / k.fy).astype(np.float32)
    a, b, c = (np.float32(value) for value in fit.inverse_depth)
    plane = a * x[None, :] + b * y[:, None] + c
    z = np.where(frame.depth > 0, frame.depth * np.float32(frame.depth_scale_m), np.float32(np.inf))
    above_m = np.where(frame.depth > 0, (1 - plane * z) / np.linalg.norm(fit.inverse_depth), 0)
    load = np.abs(above_m) > LOAD_ABOVE_M
    if frame.mask is not None:
        load |= frame.mask > 0
    # Single pixels are islands and noise, not load.
    load_image = cv2.morphologyEx(load.astype(np.uint8), cv2.MORPH_OPEN, np.ones((5, 5), np.uint8))
    side = 2 * BESIDE_LOAD_PX + 1
    beside = cv2.dilate(load_image, np.ones((side, side), np.uint8)) > 0
    return np.asarray((d > 0) & ~beside & ~load)


def _quantiles(values: NDArray[np.floating], at: Quantiles) -> Quantiles:
    low, middle, high = (float(v) for v in np.quantile(values, at))
    return low, middle, high
