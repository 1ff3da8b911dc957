"""Flanks that a stereo camera's matching window raises: how far, as other frames show them, and taken off again.

A window that reaches over a tuber's outline takes the disparity of what stands out in it. So within half a window of
its outline a tuber seems to stay as high as it is farther inside: a fuller body, which weighs more. A frame that sees
the same flank from farther above, well inside its outline, shows it as it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel
from segmenter.outline.body import Body
from segmenter.outline.growth import inside_px

BINS = 12
"""Pixels inside the outline, one each; the first are the outermost pixels."""
DEEP_PX = 8.0
"""How deep inside its outline a frame shows a flank as it is."""
EVERY_PX, MOST_M, LEAST_POINTS = 2, 0.006, 5
"""Of a frame every second pixel of every second row is compared; what differs by more is not of one place; so many
pixels of a bin say something."""
JUDGED = slice(2, 5)
"""Bins that say whether flanks are raised: farther out they are few, farther inside little is."""
LEAST_RISEN_MM, SURE, LEAST_TUBERS = 0.25, 3.0, 4
"""Flanks that are raised by less in the mean of `JUDGED`, or by less than so many standard errors, stay as they are:
cameras whose window does not do it say -1.1 to +0.2 mm."""
KEPT = 60
"""Tubers, the newest ones."""
LEAST_TAKEN_MM = 0.1
"""Farther inside than the first bin that is raised by less, nothing is."""


@dataclass(frozen=True, slots=True)
class FlankReading:
    """How far a camera raises flanks.

    Attributes:
        risen_mm: (`BINS`,) by pixel inside the outline, NaN where nothing is known; below 0 they are lowered.
        sd_mm: how well the mean of those that are judged is known. tubers: how many say so.
    """

    risen_mm: tuple[float, ...]
    sd_mm: float
    tubers: int

    @property
    def judged_mm(self) -> float:
        """Mean of the bins that are judged."""
        return float(np.mean(self.risen_mm[JUDGED]))

    @property
    def raised_m(self) -> tuple[float, ...]:
        """What to take off, metres, by pixel inside the outline; nothing where flanks are not raised for sure."""
        if not self.judged_mm >= max(LEAST_RISEN_MM, SURE * self.sd_mm):  # NaN, too
            return ()
        risen_mm = np.array(self.risen_mm)
        risen_mm[: JUDGED.start] = risen_mm[JUDGED.start]  # of the outermost pixels the few that are seen say too much
        little = ~(risen_mm >= LEAST_TAKEN_MM)
        until = int(little.argmax()) if little.any() else BINS
        return tuple((risen_mm[:until] / 1000).round(5).tolist())

    def gauges(self) -> dict[str, float]:
        """Levels as `conveyor.belt_findings` takes them."""
        return {"flanks_raised_mm": self.judged_mm if self.raised_m else 0.0}


class FlankWatch:
    """Keeps what pairs of frames say of the newest tubers."""

    def __init__(self) -> None:
        self._pairs: dict[int, list[NDArray[np.float64]]] = {}
        self._tubers: dict[int, NDArray[np.float64]] = {}
        self.reading: FlankReading | None = None

    @property
    def said_mm(self) -> NDArray[np.float64]:
        """(n, `BINS`) millimetres by which flanks of each tuber are raised, the newest last; NaN where not known."""
        return np.array(list(self._tubers.values())).reshape(-1, BINS)

    def recall(self, said_mm: NDArray[np.float64]) -> None:
        """Begin with what an earlier watch said of the same camera."""
        self._tubers = dict(zip(range(-len(said_mm), 0), said_mm, strict=True))
        self.reading = self._read()

    def add(self, tuber: int, risen_m: NDArray[np.float64]) -> None:
        """(`BINS`,) metres that a pair of its frames say, as `risen_m` gives them."""
        pairs = self._pairs.setdefault(tuber, [])
        pairs.append(risen_m)
        self._tubers[tuber] = 1000 * _middle(np.array(pairs))
        for kept in (self._pairs, self._tubers):
            while len(kept) > KEPT:
                del kept[next(iter(kept))]
        self.reading = self._read()

    def _read(self) -> FlankReading | None:
        said_mm = self.said_mm
        judged_mm = said_mm[:, JUDGED].mean(1)
        judged_mm = judged_mm[~np.isnan(judged_mm)]
        if len(judged_mm) < LEAST_TUBERS:
            return None
        spread_mm = 1.4826 * float(np.median(np.abs(judged_mm - np.median(judged_mm))))
        return FlankReading(
            risen_mm=tuple(_middle(said_mm).tolist()),
            sd_mm=1.2533 * spread_mm / len(judged_mm) ** 0.5,
            tubers=len(judged_mm),
        )


def _middle(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, `BINS`) -> (`BINS`,) medians of what is known; NaN where nothing is."""
    ordered = np.sort(values, 0)  # NaN last
    known = np.count_nonzero(~np.isnan(values), 0)
    column = np.arange(values.shape[1])
    middle: NDArray[np.float64] = (ordered[(known - 1) // 2, column] + ordered[known // 2 - (known == 0), column]) / 2
    return middle


def risen_m(first: Body, second: Body, turn: NDArray[np.float64], shift_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """(`BINS`,) by how much nearer the second frame sees flanks than the first, by pixel inside its outline; NaN where
    the first does not show them.

    Args:
        turn, shift_m: (3, 3), (3,) metres, from places in the first camera to the second, once surfaces lie on one
            another.
    """
    sums, counts = _sums(first.depth_m, first.rim_px, first.camera, turn, shift_m,
                         second.depth_m, second.rim_px, second.camera)  # fmt: skip
    return np.where(counts >= LEAST_POINTS, sums / np.maximum(counts, 1), np.nan)


@kernel(nogil=True, error_model="numpy")
def _sums(
    depth_m: NDArray[np.float32],
    rim_px: NDArray[np.float32],
    camera: NDArray[np.float64],
    turn: NDArray[np.float64],
    shift_m: NDArray[np.float64],
    to_m: NDArray[np.float32],
    to_rim_px: NDArray[np.float32],
    to: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Metres and how many pixels, by pixel inside the second frame's outline."""
    sums, counts = np.zeros(BINS), np.zeros(BINS)
    for v in range(0, depth_m.shape[0], EVERY_PX):
        for u in range(0, depth_m.shape[1], EVERY_PX):
            z = float(depth_m[v, u])
            if rim_px[v, u] < DEEP_PX or z == 0:
                continue
            x, y = (u - camera[2]) * z / camera[0], (v - camera[3]) * z / camera[1]
            cx = turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z + shift_m[0]
            cy = turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z + shift_m[1]
            cz = turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z + shift_m[2]
            pu, pv = cx * to[0] / cz + to[2], cy * to[1] / cz + to[3]
            j, i = int(np.floor(pu)), int(np.floor(pv))
            if i < 0 or j < 0 or i >= to_m.shape[0] - 1 or j >= to_m.shape[1] - 1:
                continue
            if min(to_m[i, j], to_m[i + 1, j], to_m[i, j + 1], to_m[i + 1, j + 1]) <= 0:
                continue
            b, a = pu - j, pv - i
            there = (1 - a) * ((1 - b) * to_m[i, j] + b * to_m[i, j + 1])
            there += a * ((1 - b) * to_m[i + 1, j] + b * to_m[i + 1, j + 1])
            inside = (1 - a) * ((1 - b) * to_rim_px[i, j] + b * to_rim_px[i, j + 1])
            inside += a * ((1 - b) * to_rim_px[i + 1, j] + b * to_rim_px[i + 1, j + 1])
            k = int(inside)
            if k < BINS and abs(cz - there) < MOST_M:
                sums[k] += cz - there
                counts[k] += 1
    return sums, counts


def without_rise(depth: NDArray[np.uint16], raised_m: tuple[float, ...], *, depth_scale_m: float) -> NDArray[np.uint16]:
    """(h, w) `depth` with its flanks as far away as they are; 0 stays 0.

    Args:
        depth: (h, w) of a view, 0 outside the tuber. raised_m: as `FlankReading.raised_m`; () leaves it as it is.
    """
    if not raised_m:
        return depth
    taken_m = np.interp(inside_px(depth), np.arange(len(raised_m) + 1) + 0.5, (*raised_m, 0.0))
    farther = np.rint(depth + taken_m / depth_scale_m)
    return np.where(depth > 0, np.minimum(farther, np.iinfo(np.uint16).max), 0).astype(np.uint16)
