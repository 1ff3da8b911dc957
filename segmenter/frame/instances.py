"""Tuber instances in one depth frame, classically: no weights to train, and every cut can be explained.

Height over the belt, median-filtered; cells above the foreground height; cut where the height jumps (occluding
contours); relief = distance to the background + a share of the height; flooded from its peaks downwards; regrown to the
rims.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel
from conveyor.reasons import InstanceRefusal
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.constants import (
    COARSE_QUANTUM_MM,
    LEAST_ROWS,
    LEAST_SEEN_OF_RASTER,
    QUANTUM_MM,
    TALL_MM,
    TALL_SHARE,
)
from segmenter.frame.edges import cut_by_unseen
from segmenter.frame.flood import flood, regrow, relabel
from segmenter.frame.heights import HeightMap
from segmenter.frame.place import centre_in_belt
from segmenter.frame.seams import SeamSettings, merge_fragments
from segmenter.frame.sums import BORDERS, BOX, STEP_MM, instance_sums


@dataclass(frozen=True, slots=True)
class SplitSettings:
    """Of the raster, in millimetres; the defaults hold for tubers of 25 to 120 mm.

    Attributes:
        pixel_mm: size of a cell. Finer costs time with its square, coarser blurs seams; 2 and more show no skin.
        foreground_mm: lower is belt. Lower takes in cleats and soil, higher loses rims, which regrowth brings back.
        cut_mm_per_mm: a steeper step is the contour of one tuber over another, and cut.
        opening_mm: radius of what is opened away: bridges between tubers, stalks.
        height_share: of the height in the relief, beside the distance to the background. More splits tubers that lie
            on one another, less those side by side.
        least_dynamics_mm, dynamics_share: what a peak of the relief must rise over the pass to a higher one, absolutely
            and of its own height. More merges small tubers, less splits knobby ones.
        regrow_mm, rim_mm: how far an instance grows back over cells higher than `rim_mm`, to its rim.
        min_area_mm2, min_height_mm: smaller or lower is no tuber.
        min_mean_mm: mean height below which an instance is the belt's own relief, a cleat or soil (at most 14.1 mm in
            the suite, tubers 17.2 mm and more): what lies beside a tuber has part of its flank, so its peak does not
            tell.
        seam: when fragments are merged.
    """

    pixel_mm: float = 1.45
    foreground_mm: float = 11.0
    cut_mm_per_mm: float = 5.0
    opening_mm: float = 3.0
    height_share: float = 0.7
    least_dynamics_mm: float = 1.5
    dynamics_share: float = 0.18
    regrow_mm: float = 6.0
    rim_mm: float = 7.0
    min_area_mm2: float = 350.0
    min_height_mm: float = 18.0
    min_mean_mm: float = 14.5
    seam: SeamSettings = field(default_factory=SeamSettings)


@dataclass(frozen=True, slots=True)
class Instances:
    """The instances of one frame; row k of every array belongs to label k + 1.

    Attributes:
        labels: (h, w) int32 on the analysis raster, 0 = none; `stride` full-resolution pixels per cell.
        centre_m: (n, 2) belt x, y of the centres, free of lean.
        centroid_px: (n, 2) full-resolution u, v of the masks' centroids.
        area_m2: (n,) visible area, projected onto the belt.
        volume_m3: (n,) under the visible surface down to the belt.
        height_m: (n,) highest point but for the last percent.
        cut: (n, 4) bool: touches the top, bottom, left, right border of the image, or of what was seen of it.
        part: (n,) bool: a side cuts it and its own centre is not known, so `centre_m` is that of the part seen.
        box: (n, 4) int: first and last row, first and last column, cells.
        contact: (n,) share of the outline that touches another instance.
        refused: what looked like load but cannot be a tuber, by reason.
    """

    labels: NDArray[np.int32]
    stride: int
    centre_m: NDArray[np.float64]
    centroid_px: NDArray[np.float64]
    area_m2: NDArray[np.float64]
    volume_m3: NDArray[np.float64]
    height_m: NDArray[np.float64]
    cut: NDArray[np.bool_]
    part: NDArray[np.bool_]
    box: NDArray[np.int64]
    contact: NDArray[np.float64]
    refused: dict[InstanceRefusal, int]

    def __len__(self) -> int:
        return len(self.area_m2)


def split(heights: HeightMap, belt: BeltGeometry, settings: SplitSettings) -> Instances:
    """The instances on a height map. The raster is worked on in millimetres; what comes out is SI."""
    cell_mm = heights.cell_mm
    quantum_mm = _quantum_mm(heights)
    quantised = _quantised(heights.height_mm, np.float32(1 / quantum_mm))
    quantised = np.asarray(cv2.medianBlur(quantised, 5), np.uint8)
    jump = np.asarray(cv2.morphologyEx(quantised, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)), np.uint8)
    foreground = _foreground(
        quantised, jump, settings.foreground_mm / quantum_mm, settings.cut_mm_per_mm * cell_mm / quantum_mm
    )
    radius = max(1, round(settings.opening_mm / cell_mm))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    foreground = np.asarray(cv2.morphologyEx(foreground, cv2.MORPH_OPEN, disc), np.uint8)
    distance = np.asarray(cv2.distanceTransform(foreground, cv2.DIST_L2, 3), np.float32)
    smooth_mm, relief = _relief(
        quantised, distance, np.float32(quantum_mm), np.float32(cell_mm), np.float32(settings.height_share)
    )
    relief = np.asarray(cv2.GaussianBlur(relief, (5, 5), 0), np.float32)
    labels, n = flood(relief, foreground, settings.least_dynamics_mm, settings.dynamics_share)
    regrow(labels, smooth_mm, settings.rim_mm, max(1, round(settings.regrow_mm / cell_mm)))
    merge_fragments(labels, n, smooth_mm, cell_mm, settings.seam)
    return _describe(labels, n, smooth_mm, heights.seen, heights.stride, belt, settings)


@kernel()
def _quantised(height_mm: NDArray[np.float32], per_mm: np.float32) -> NDArray[np.uint8]:
    """(h, w) heights in steps of the 8-bit raster, at most 255."""
    steps = np.empty(height_mm.shape, np.uint8)
    for i in range(height_mm.shape[0]):
        for j in range(height_mm.shape[1]):
            steps[i, j] = np.uint8(min(height_mm[i, j] * per_mm, np.float32(255)))
    return steps


@kernel()
def _foreground(
    quantised: NDArray[np.uint8], jump: NDArray[np.uint8], over: float, steepest: float
) -> NDArray[np.uint8]:
    """(h, w) 1 where a cell is higher than `over` and its height jumps by no more than `steepest`, both in steps."""
    foreground = np.empty(quantised.shape, np.uint8)
    for i in range(quantised.shape[0]):
        for j in range(quantised.shape[1]):
            foreground[i, j] = (quantised[i, j] > over) & (jump[i, j] <= steepest)
    return foreground


@kernel()
def _relief(
    quantised: NDArray[np.uint8], distance: NDArray[np.float32], quantum_mm: Any, cell_mm: Any, share: Any
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(h, w) float32 each: heights in millimetres again, and the distance to the background with a share of them."""
    smooth_mm, relief = np.empty(quantised.shape, np.float32), np.empty(quantised.shape, np.float32)
    for i in range(quantised.shape[0]):
        for j in range(quantised.shape[1]):
            height = np.float32(quantised[i, j]) * quantum_mm
            smooth_mm[i, j] = height
            relief[i, j] = distance[i, j] * cell_mm + height * share
    return smooth_mm, relief


def _quantum_mm(heights: HeightMap) -> float:
    """Millimetres per step of the 8-bit raster: coarser where a heap stands higher than the fine one reaches."""
    tall = np.count_nonzero(heights.height_mm > TALL_MM) > TALL_SHARE * heights.height_mm.size
    return COARSE_QUANTUM_MM if tall else QUANTUM_MM


def given(mask: NDArray[np.uint16], heights: HeightMap, belt: BeltGeometry) -> Instances:
    """The instances of a given (H, W) label image, described like those found on depth; none is refused by size."""
    stride = heights.stride
    rows, columns = heights.height_mm.shape
    half = stride // 2
    coarse = mask[half : rows * stride : stride, half : columns * stride : stride]
    there = np.zeros(np.iinfo(np.uint16).max + 1, np.bool_)
    there[coarse] = True
    there[0] = False
    numbers = np.where(there, np.cumsum(there, dtype=np.int32), np.int32(0))
    labels = numbers[coarse]
    n = int(np.count_nonzero(there))
    return _describe(labels, n, heights.height_mm, heights.seen, stride, belt, None)


def full_resolution(instances: Instances, depth: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """(H, W) uint16 labels at the frame's own resolution, 0 where there is no depth."""
    rows, columns = depth.shape
    stride = instances.stride
    i = np.minimum(np.arange(rows) // stride, instances.labels.shape[0] - 1)
    j = np.minimum(np.arange(columns) // stride, instances.labels.shape[1] - 1)
    full: NDArray[np.uint16] = instances.labels[i[:, None], j[None, :]].astype(np.uint16)
    full[depth == 0] = 0
    return full


def _describe(
    labels: NDArray[np.int32],
    n: int,
    height_mm: NDArray[np.float32],
    seen: NDArray[np.uint8],
    stride: int,
    belt: BeltGeometry,
    settings: SplitSettings | None,
) -> Instances:
    """Measure all labels, refuse what cannot be a tuber (where `settings` say so), and number the rest 1..n."""
    k = belt.intrinsics
    a, b, c, t = (1000.0 * value for value in belt.height_coefficients())
    margin = max(1, round(2 / stride))
    area_factor = stride * stride / (k.fx * k.fy) * 1e6
    sums, histogram = instance_sums(
        labels, n, height_mm, coefficients_mm=(a, b, c, t), stride=stride, area_factor=area_factor, margin=margin
    )
    cut = np.stack([sums[side] > 0 for side in BORDERS], axis=1)
    if np.count_nonzero(seen) > LEAST_SEEN_OF_RASTER * seen.size:
        cut |= cut_by_unseen(labels, n, seen, margin) >= LEAST_ROWS
    gone = sums["cells"] == 0
    low = ~gone & (sums["area_mm2"] < settings.min_area_mm2) if settings else np.zeros(n + 1, bool)
    flat = ~gone & ~low & _lies_flat(sums, settings) if settings else np.zeros(n + 1, bool)
    small = int(low[1:].sum())
    refused = {InstanceRefusal.SMALL: small, InstanceRefusal.FLAT: int(flat[1:].sum())} if settings else {}
    keep = ~(gone | low | flat)
    keep[0] = False
    names = np.zeros(n + 1, np.int32)
    names[keep] = np.arange(1, int(keep.sum()) + 1)
    if not keep[1:].all():
        relabel(labels, names)
    sums, histogram, cut = sums[keep], histogram[keep], cut[keep]
    half = (stride - 1) / 2
    centroid = np.stack([sums[axis] / sums["cells"] * stride + half for axis in ("columns", "rows")], axis=1)
    height_m = _percentile_mm(histogram, sums["peak_mm"]) / 1000.0
    centres = [centre_in_belt(belt, u, v, h) for (u, v), h in zip(centroid.tolist(), height_m.tolist(), strict=True)]
    return Instances(
        labels=labels,
        stride=stride,
        centre_m=np.array(centres).reshape(-1, 2),
        centroid_px=centroid,
        area_m2=sums["area_mm2"] * 1e-6,
        volume_m3=sums["volume_mm3"] * 1e-9,
        height_m=height_m,
        cut=cut,
        part=np.asarray(cut[:, 2:].any(axis=1)),
        box=np.stack([sums[end] for end in BOX], axis=1),
        contact=sums["touching"] / np.maximum(sums["outline"], 1),
        refused=refused,
    )


def _lies_flat(sums: NDArray[np.void], settings: SplitSettings) -> NDArray[np.bool_]:
    """(n + 1,) which labels are too low for a tuber, by their peak or by their mean height."""
    mean_mm = sums["volume_mm3"] / np.maximum(sums["area_mm2"], 1.0)
    flat: NDArray[np.bool_] = (sums["peak_mm"] < settings.min_height_mm) | (mean_mm < settings.min_mean_mm)
    return flat


def _percentile_mm(
    histogram: NDArray[np.int32], peak_mm: NDArray[np.float64], share: float = 0.99
) -> NDArray[np.float64]:
    """Height below which `share` of an instance's cells lie, interpolated in its histogram, at most its peak."""
    cumulated = np.cumsum(histogram, axis=1)
    wanted = share * cumulated[:, -1]
    step = np.argmax(cumulated >= wanted[:, None], axis=1)
    rows = np.arange(len(histogram))
    inside = np.maximum(histogram[rows, step], 1)
    before = cumulated[rows, step] - histogram[rows, step]
    height: NDArray[np.float64] = np.minimum(STEP_MM * (step + (wanted - before) / inside), peak_mm)
    return height
