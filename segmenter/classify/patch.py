"""The averaged top view (patch) of a track: heights around its centre from straight above, at 2 mm a cell.

A stereo camera's noise makes the smooth skin of a tuber as rough as a clod in any single frame; it differs from frame
to frame, and the clod does not. Each point is put where it lies on the belt, by its own height: in the image the top of
a tuber moves 10 mm against its rim while it passes, and an average there would smooth the clod too.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel
from segmenter.classify.quadric import departures
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.heights import HeightMap
from segmenter.frame.instances import Instances

# What a patch is. The network was trained on exactly this: changing any of it needs a new training.
SIZE = 48
"""Cells along a side; with `CELL_MM` 96 mm, so that all but the longest tubers fit."""
CELL_MM = 2.0
CHANNELS = 10
FULL_MM = 60.0
FINE_MM = 1.5
SPREAD_MM = 3.0
UNSURE_MM = 0.5
"""Millimetres that make 1: of the mean height, the fine relief, the spread over observations, the mean's error."""
FINE_SIGMA = 2.0
"""Cells over which the surroundings of the fine relief are smoothed."""
BANDS = ((1.0, 3.0, 1.0), (2.5, 6.0, 3.0))
"""Of the body's own relief: cells over which it is smoothed, cells of its surroundings, millimetres that make 1."""
DEPARTURES_MM = (1.5, 6.0)
LEAST_OBSERVATIONS = 3
"""Fewer are no evidence: the network would classify the noise."""
AROUND_MM = 12.0
"""Millimetres around an instance's box that its observation shows too."""
COARSEST_MM = 2.1
"""Raster cells larger than this show no skin: what is seen with them is no evidence."""


@dataclass(frozen=True, slots=True)
class Observation:
    """One frame's part of a patch, each (48, 48) float32, rows along the belt's x, columns along y.

    `height_mm`: mean of what was seen there, 0 where nothing was; `seen`: 1 where something was; `inside`: share of it
    that belongs to the instance.
    """

    height_mm: NDArray[np.float32]
    seen: NDArray[np.float32]
    inside: NDArray[np.float32]


def _empty() -> NDArray[np.float32]:
    return np.zeros((SIZE, SIZE), np.float32)


@dataclass(slots=True)
class Patch:
    """The averaged top view of one track, kept as sums over its observations."""

    observations: int = 0
    _height: NDArray[np.float32] = field(default_factory=_empty)
    _square: NDArray[np.float32] = field(default_factory=_empty)
    _seen: NDArray[np.float32] = field(default_factory=_empty)
    _inside: NDArray[np.float32] = field(default_factory=_empty)

    def add(self, observation: Observation) -> None:
        """Take one more observation."""
        self.observations += 1
        self._height += observation.height_mm
        self._square += observation.height_mm * observation.height_mm
        self._seen += observation.seen
        self._inside += observation.inside

    def spread(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """(48, 48) float32 each: standard deviation over the observations in millimetres, how many saw a cell (at least
        1), share of a cell that is the instance.
        """
        count: NDArray[np.float32] = np.maximum(self._seen, np.float32(1)).astype(np.float32)
        mean_mm = self._height / count
        spread_mm: NDArray[np.float32] = np.sqrt(np.maximum(self._square / count - mean_mm * mean_mm, 0))
        return spread_mm, count, (self._inside / count).astype(np.float32)

    def channels(self) -> NDArray[np.float32]:
        """(10, 48, 48) float32 as the network takes it; there must be an observation."""
        sums = (image[None] for image in (self._height, self._square, self._seen, self._inside))
        return np.asarray(as_channels(*sums, observations=np.array([self.observations], np.float32))[0])


def as_channels(
    height: NDArray[np.float32],
    square: NDArray[np.float32],
    seen: NDArray[np.float32],
    inside: NDArray[np.float32],
    *,
    observations: NDArray[np.float32],
) -> NDArray[np.float32]:
    """(n, 10, 48, 48) float32 channels of n bodies from the sums over their observations.

    Args:
        height, square, seen, inside: (n, 48, 48) sums over the observations of each body.
        observations: (n,) how many there were.

    Returns:
        Mean height / 60 mm, the same over its surroundings / 1.5 mm, how much of it is the instance, spread from
        observation to observation / 3 mm, share of the observations that saw it, standard error of the mean / 0.5 mm,
        the instance's own relief at two scales (`BANDS`), to which its neighbours add nothing, and how far it departs
        from an ellipsoid / 1.5 and / 6 mm.
    """
    count: NDArray[np.float32] = np.maximum(seen, np.float32(1)).astype(np.float32)
    mean_mm: NDArray[np.float32] = (height / count).astype(np.float32)
    share: NDArray[np.float32] = (inside / count).astype(np.float32)
    spread_mm = np.sqrt(np.maximum(square / count - mean_mm * mean_mm, 0))
    here = (seen > 0).astype(np.float32)
    fine = here * (mean_mm - _smoothed(mean_mm, here, FINE_SIGMA))
    bands = [
        np.clip(share * (_smoothed(mean_mm, share, near) - _smoothed(mean_mm, share, far)) / unit_mm, -4, 4)
        for near, far, unit_mm in BANDS
    ]
    departure_mm = departures(mean_mm, share)
    channels: NDArray[np.float32] = np.stack(
        [
            mean_mm / FULL_MM,
            np.clip(fine / FINE_MM, -4, 4),
            share,
            np.minimum(spread_mm / SPREAD_MM, 3),
            seen / observations[:, None, None],
            np.minimum(spread_mm / np.sqrt(count) / UNSURE_MM, 4),
            *bands,
            *(np.clip(departure_mm / unit_mm, -4, 4) for unit_mm in DEPARTURES_MM),
        ],
        axis=1,
    ).astype(np.float32)
    return channels


def _smoothed(mean_mm: NDArray[np.float32], weight: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    """Weighted mean over the neighbourhood."""
    blur = _blur(sigma)
    total, of = (blur @ image @ blur.T for image in (mean_mm * weight, weight))
    return np.asarray(total / np.maximum(of, np.float32(1e-3)), np.float32)


@lru_cache
def _blur(sigma: float) -> NDArray[np.float32]:
    """(48, 48) what blurs along a side, mirrored at the ends: many images at once are two products."""
    kernel = cv2.getGaussianKernel(round(8 * sigma + 1) | 1, sigma)
    rows = cv2.filter2D(np.eye(SIZE), cv2.CV_64F, kernel, borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(rows, np.float32)


def observe_instance(
    heights: HeightMap, instances: Instances, index: int, belt: BeltGeometry, *, x_m: float, y_m: float
) -> Observation:
    """What a frame shows of instance `index`, around (x, y) on the belt.

    An instance's own centre wanders by a millimetre from frame to frame, and the body's skin would be blurred by that.
    """
    i0, i1, j0, j1 = (int(value) for value in instances.box[index])
    around = round(AROUND_MM / heights.cell_mm)
    rows, columns = instances.labels.shape
    box = (max(0, i0 - around), min(rows, i1 + around + 1), max(0, j0 - around), min(columns, j1 + around + 1))
    k, m = belt.intrinsics, belt.belt_from_camera
    height_mm, seen, inside = _from_above(
        heights.height_mm, heights.seen, instances.labels, index + 1, box, heights.stride,
        np.array(belt.height_coefficients()), np.array([k.fx, k.fy, k.cx, k.cy]),
        np.ascontiguousarray(m[:2, :3]), m[:2, 3].copy(), x_m, y_m,
    )  # fmt: skip
    return Observation(height_mm, seen, inside)


@kernel(error_model="numpy")
def _from_above(
    height_mm: NDArray[np.float32],
    measured: NDArray[np.uint8],
    labels: NDArray[np.int32],
    label: int,
    box: tuple[int, int, int, int],
    stride: int,
    heights: NDArray[np.float64],
    k: NDArray[np.float64],
    rotation: NDArray[np.float64],
    shift: NDArray[np.float64],
    x_m: float,
    y_m: float,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Put the cells of a box where they lie on the belt: mean height, seen, share of `label`."""
    total = np.zeros((SIZE, SIZE), np.float32)
    seen = np.zeros((SIZE, SIZE), np.float32)
    inside = np.zeros((SIZE, SIZE), np.float32)
    a, b, c, t = heights
    half = (stride - 1) / 2.0
    # Tangents of the rays of the columns, and what the slope of the heights has of them: divided once, not per cell.
    across_z, of_column = np.empty(box[3] - box[2]), np.empty(box[3] - box[2])
    for j in range(box[2], box[3]):
        u = j * stride + half
        across_z[j - box[2]], of_column[j - box[2]] = (u - k[2]) / k[0], a * u
    rows, columns = np.empty(box[3] - box[2], np.int32), np.empty(box[3] - box[2], np.int32)
    for i in range(box[0], box[1]):
        v = i * stride + half
        along_z, of_row = (v - k[3]) / k[1], b * v
        own_mm = height_mm[i, box[2] : box[3]]
        # Without a branch, so that the compiler takes several cells at once.
        for j in range(len(rows)):
            z = (own_mm[j] * 1e-3 - t) / (of_column[j] + of_row + c)
            x, y = across_z[j] * z, along_z * z
            along = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z + shift[0] - x_m
            across = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z + shift[1] - y_m
            row, column = (
                np.floor(along * 1000.0 / CELL_MM + SIZE / 2.0),
                np.floor(across * 1000.0 / CELL_MM + SIZE / 2.0),
            )
            rows[j] = np.int32(min(max(row, -1.0), float(SIZE)))
            columns[j] = np.int32(min(max(column, -1.0), float(SIZE)))
        for j in range(box[2], box[3]):
            row, column = rows[j - box[2]], columns[j - box[2]]
            if measured[i, j] and 0 <= row < SIZE and 0 <= column < SIZE:
                total[row, column] += height_mm[i, j]
                seen[row, column] += 1
                inside[row, column] += labels[i, j] == label
    for row in range(SIZE):
        for column in range(SIZE):
            n = seen[row, column]
            if n > 0:
                total[row, column] /= n
                inside[row, column] /= n
                seen[row, column] = 1
    return total, seen, inside
