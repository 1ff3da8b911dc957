"""Errors over a whole belt plane: a plane is linear in disparity, and what departs from it slowly is the camera's.

What is the same in every frame and slower than 40 pixels is the bow of the field of view. The rest, from 3 pixels on,
is the mid-scale error; the relief of the belt (soil, cleats) is in it, for no camera can tell the two apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.depth_noise import Disparity

FINE_PX, SLOW_PX = 1.5, 20.0
"""Standard deviations of the two blurs: they halve waves of some 8 and 110 pixels."""
LEAST_WEIGHT = 0.5
"""Share of a blur's window that must show the plane."""
LEAST_SHARE = 0.1
"""Share of the image that must show the plane in a frame."""
BOW_LEAST_SHARE = 0.2
"""Share of the image in which the plane was seen often enough to tell the bow."""


@dataclass(frozen=True, slots=True)
class FieldError:
    """Standard deviations in pixels of disparity; `frames` showed the plane. `bow`: (h, w) float32, NaN where unseen.

    `bow_px` is None where too little of the plane was seen.
    """

    mid_px: float
    bow_px: float | None
    frames: int
    bow: NDArray[np.float32]


def field_error(images: Sequence[Disparity], planes: Sequence[NDArray[np.bool_]]) -> FieldError | None:
    """Errors of the belt plane seen in `images`; None where no image shows enough of it.

    Args:
        images: (h, w) disparity in pixels each.
        planes: (h, w) each: which pixels show the belt plane.
    """
    seen = [(d, on) for d, on in zip(images, planes, strict=True) if on.mean() >= LEAST_SHARE]
    if not seen:
        return None
    shape = seen[0][0].shape
    halves = [np.zeros(shape), np.zeros(shape)]
    weights = [np.zeros(shape), np.zeros(shape)]
    squares: list[float] = []
    for d, on in seen:
        left = _beside_plane(d, on)
        fine, enough = _blurred(left, on, FINE_PX)
        shown = enough & on
        if not shown.any():  # thin lines or single pixels, nowhere a piece of the plane
            continue
        half = len(squares) % 2
        squares.append(float(np.mean(fine[shown] ** 2)))
        halves[half] += np.where(on, left, 0)
        weights[half] += on
    if not squares:
        return None
    slow, bow_px = _bow(halves, weights, single=len(squares) == 1)
    total = float(np.mean(squares))
    return FieldError(float(np.sqrt(max(total - (bow_px or 0.0) ** 2, 0.0))), bow_px, len(squares), slow)


def _bow(
    halves: list[NDArray[np.float64]], weights: list[NDArray[np.float64]], *, single: bool
) -> tuple[NDArray[np.float32], float | None]:
    """The slow field of all frames, and its standard deviation: what both halves of the frames have in common."""
    seen = weights[0] + weights[1]
    whole, enough = _blurred((halves[0] + halves[1]) / np.maximum(seen, 1), seen, SLOW_PX)
    field = np.where(enough, whole, np.nan).astype(np.float32)
    if single:
        return field, float(np.nanstd(field)) if enough.mean() >= BOW_LEAST_SHARE else None
    parts = [_blurred(half / np.maximum(w, 1), w, SLOW_PX) for half, w in zip(halves, weights, strict=True)]
    both = parts[0][1] & parts[1][1]
    if both.mean() < BOW_LEAST_SHARE:
        return field, None
    one, other = (part[0][both] - part[0][both].mean() for part in parts)
    return field, float(np.sqrt(max(np.mean(one * other), 0.0)))


def _beside_plane(d: Disparity, on: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(h, w) disparity minus the plane through the pixels `on`; 0 elsewhere."""
    rows, columns = np.nonzero(on)
    design = np.stack([columns - d.shape[1] / 2, rows - d.shape[0] / 2, np.ones(len(rows))], axis=1)
    thin = slice(None, None, max(1, len(rows) // 20_000))
    found = np.linalg.lstsq(design[thin], d[on][thin].astype(np.float64), rcond=None)[0]
    left = np.zeros(d.shape)
    left[on] = d[on] - design @ found
    return left


def _blurred(
    values: NDArray[np.float64], weight: NDArray[np.bool_] | NDArray[np.float64], sigma_px: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(h, w) weighted local mean, and where enough of its window was seen."""
    w = np.asarray(weight, np.float32)
    total = cv2.GaussianBlur((values * w).astype(np.float32), (0, 0), sigma_px)
    of = cv2.GaussianBlur(w, (0, 0), sigma_px)
    enough = of >= LEAST_WEIGHT * float(w.max())
    return np.asarray(total / np.maximum(of, 1e-6), np.float64), enough
