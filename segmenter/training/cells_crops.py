"""Training crops of the network of cells: a piece of a frame around some body, turned, scaled, worsened at random."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from segmenter.classes import REACH, STEP, TUBER, as_channels
from segmenter.training.pack import LabelledGrid

CROP = 160
"""Cells of 2 mm; a multiple of 32."""
WHITE_MM = 2.0


@dataclass(frozen=True, slots=True)
class Crop:
    """Input and truth: image (3, 160, 160) float32; classes (80, 80) uint8; bodies (80, 80) int32; towards
    (2, 80, 80) float32, rows and columns to the tuber's centre in units of `REACH` output cells.
    """

    image: NDArray[np.float32]
    classes: NDArray[np.uint8]
    bodies: NDArray[np.int32]
    towards: NDArray[np.float32]


def draw_crop(grid: LabelledGrid, rng: Generator) -> Crop:
    """One crop of a frame."""
    rows, columns = grid.classes.shape
    half = CROP // STEP
    load = np.flatnonzero(grid.bodies)
    at = int(load[rng.integers(len(load))]) if len(load) else int(rng.integers(grid.bodies.size))
    top, left = at // columns - int(rng.integers(half)), at % columns - int(rng.integers(half))
    top, left = (
        int(np.clip(top, min(0, rows - half), max(0, rows - half))),
        int(np.clip(left, min(0, columns - half), max(0, columns - half))),
    )
    height_mm = _window(grid.height_mm, top * STEP, left * STEP, CROP)
    seen = _window(grid.seen.astype(np.float32) / np.float32(255), top * STEP, left * STEP, CROP)
    classes, bodies = _window(grid.classes, top, left, half), _window(grid.bodies, top, left, half).astype(np.int32)
    flip, turns = bool(rng.random() < 0.5), int(rng.integers(4))
    height_mm, seen, classes, bodies = (_turned(a, flip, turns) for a in (height_mm, seen, classes, bodies))
    height_mm = _worsened(height_mm, rng)
    return Crop(as_channels(height_mm, seen), classes, bodies, towards_centres(classes, bodies))


def towards_centres(classes: NDArray[np.uint8], bodies: NDArray[np.int32]) -> NDArray[np.float32]:
    """(2, h, w) float32: rows and columns from each tuber cell to the middle of its visible part; 0 elsewhere."""
    rows, columns = np.nonzero(classes == TUBER)
    named = bodies[rows, columns]
    towards = np.zeros((2, *classes.shape), np.float32)
    if len(named):
        count = np.maximum(np.bincount(named), 1)
        for axis, position in enumerate((rows, columns)):
            middle = np.bincount(named, position) / count
            towards[axis, rows, columns] = (middle[named] - position) / REACH
    return towards


def _worsened(height_mm: NDArray[np.float32], rng: Generator) -> NDArray[np.float32]:
    """Other noise than the simulated camera's, coarser pixels, a belt that is off by a little."""
    out = height_mm * np.float32(rng.uniform(0.95, 1.05))
    if rng.random() < 0.3:
        by = rng.uniform(0.5, 0.95)
        small = cv2.resize(out, None, fx=by, fy=by, interpolation=cv2.INTER_AREA)
        out = np.asarray(cv2.resize(small, out.shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)
    if rng.random() < 0.5:
        white = rng.standard_normal(out.shape, dtype=np.float32)
        out = out + white * np.float32(rng.uniform(0.0, WHITE_MM) * rng.uniform(0.2, 1.0))
    if rng.random() < 0.2:
        out = np.asarray(cv2.GaussianBlur(out, (0, 0), rng.uniform(0.4, 1.2)), np.float32)
    shifted: NDArray[np.float32] = np.maximum(out + np.float32(rng.normal(0, 1.5)), 0).astype(np.float32)
    return shifted


def _window(array: NDArray[np.generic], top: int, left: int, size: int) -> NDArray:  # type: ignore[type-arg]
    """(size, size) part of an array, zeros where it ends."""
    out = np.zeros((size, size), array.dtype)
    part = array[max(0, top) : top + size, max(0, left) : left + size]
    out[: part.shape[0], : part.shape[1]] = part
    return out


def _turned(array: NDArray, flip: bool, turns: int) -> NDArray:  # type: ignore[type-arg]
    return np.ascontiguousarray(np.rot90(array[:, ::-1] if flip else array, turns))
