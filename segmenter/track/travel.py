"""Belt travel estimated from the frames, where no encoder tells it.

Between two frames the load moves along x only. The occupied cells of a belt raster (height above 12 mm, so that
cleats do not alias) are correlated along x, normalised by what overlaps; the best shift is refined between cells and
afterwards, by the tracker, with the tubers themselves. Where nothing lies on the belt, the last known speed carries
on.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass
from statistics import median

import numpy as np
from numpy.typing import NDArray

from conveyor.camera_clock import STANDS_AFTER_S
from conveyor.kernels import kernel
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.heights import HeightMap
from segmenter.track.constants import (
    BACK_LEAST_M,
    BACK_MPS,
    BACK_SPEEDS,
    FAR_COST,
    FAR_M,
    FIRST_MATCH,
    FIRST_WITHIN_S,
    LEAST_CELLS,
    LEAST_COMMON,
    LEAST_MATCH,
    LEAST_OVERLAP,
    MAX_SPEED_MPS,
    SPEEDS_KEPT,
    SPEEDS_TO_LOOK_BACK,
    SURE_MATCH,
    TALLEST_M,
)

CELL_M = 0.004
SPEED_WITHIN_S = 2.0
"""Frames further apart than this say how far the belt went, and nothing of its speed now."""
OCCUPIED_MM = 12.0


@dataclass(frozen=True, slots=True)
class EarlierMove:
    """The belt moved by `moved_m` metres between two frames, so often, before its speed was known. `bare`: there was
    nothing to see on it. Else there was load that was followed from none of these frames to the next.
    """

    moved_m: float
    times: int
    bare: bool

    @property
    def all_m(self) -> float:
        """All of them, metres."""
        return self.moved_m * self.times


class TravelEstimator:
    """Travel since the first frame, metres, from one height map after the other.

    Attributes:
        travel_m: at the newest frame.
        carried_ms: for how long no load was seen to move, so that travel was carried on by the last speed, or, before
            one was known, told later: milliseconds since the run began.
        torn_m: how far the load jumped back in all, as no belt does: it is not known what passed meanwhile.
    """

    def __init__(self, belt: BeltGeometry) -> None:
        k = belt.intrinsics
        self._belt = belt
        self._x0, x1 = belt.x_range(TALLEST_M)
        sides = [belt.belt_xy(u, v, 0.0)[1] for u in (0, k.width - 1) for v in (0, k.height - 1)]
        self._y0 = min(sides)
        self._shape = (int((max(sides) - self._y0) / CELL_M) + 1, int((x1 - self._x0) / CELL_M) + 1)
        self._length = 1 << int(np.ceil(np.log2(2 * self._shape[1])))
        self._last: tuple[int, NDArray[np.float32], NDArray[np.complex64]] | None = None
        self._told: tuple[int, float, HeightMap] | None = None
        self._speeds: deque[float] = deque(maxlen=SPEEDS_KEPT)
        self._blind: Counter[tuple[int, bool]] = Counter()
        self._looked_back = False
        self._unseen_ms = 0
        self.travel_m = 0.0
        self.carried_ms = 0
        self.torn_m = 0.0

    @property
    def speed_mps(self) -> float:
        """Median of the last readings; 0 before the first one."""
        return median(self._speeds) if self._speeds else 0.0

    @property
    def unfollowed_ms(self) -> int:
        """How long, in milliseconds, load passed of which it is not known how far it moved: no speed was ever seen."""
        return sum(ms * n for (ms, bare), n in self._blind.items() if not bare)

    def start_at(self, travel_m: float, *, unfollowed_ms: int = 0) -> None:
        """Carry on from a travel known from before; how far the belt moved in `unfollowed_ms` is to be told yet."""
        self.travel_m = travel_m
        self._blind = Counter({(unfollowed_ms, False): 1} if unfollowed_ms else {})
        self._looked_back = not unfollowed_ms
        self._last = None

    def told(self, travel_m: float, heights: HeightMap, captured_ns: int) -> None:
        """An encoder says where the belt is at this frame: should it fall silent, the load is followed from there."""
        before, self._told = self._told, (captured_ns, travel_m, heights)
        if before is not None and 0 < (elapsed_s := (captured_ns - before[0]) * 1e-9) < SPEED_WITHIN_S:
            self._speeds.append((travel_m - before[1]) / elapsed_s)
        self.start_at(travel_m)

    def step(self, heights: HeightMap, captured_ns: int) -> float:
        """Travel at this frame."""
        if self._told is not None:
            told_ns, _, told_heights = self._told
            self._last, self._told = (told_ns, *self._seen(told_heights)), None
        occupied, spectrum = self._seen(heights)
        self._unseen_ms = 0
        if self._last is not None:
            elapsed_s = (captured_ns - self._last[0]) * 1e-9
            plausible = 0 < elapsed_s < STANDS_AFTER_S
            expected_m = self.speed_mps * elapsed_s if plausible else 0.0
            reach_m = MAX_SPEED_MPS * elapsed_s if plausible else np.inf
            least = self._least_match(expected_m, elapsed_s)
            shift_m = self._shift(occupied, spectrum, expected_m, reach_m, least)
            self.travel_m += expected_m if shift_m is None else shift_m
            self.torn_m += self._jump_back_m(shift_m, elapsed_s) if plausible and shift_m is not None else 0.0
            if shift_m is None:
                self._unseen_ms = round(1000 * max(0.0, elapsed_s))
            if shift_m is not None and plausible and elapsed_s < SPEED_WITHIN_S:
                self._speeds.append(shift_m / elapsed_s)
            elif shift_m is None and plausible and not self._speeds:
                bare = min(occupied.sum(), self._last[1].sum()) < LEAST_CELLS
                self._blind[round(1000 * elapsed_s), bare] += 1
        self._last = (captured_ns, occupied, spectrum)
        return self.travel_m

    def look_back(self) -> list[EarlierMove]:
        """Once, when the speed is first known: how the belt moved before; else nothing."""
        if self._looked_back or len(self._speeds) < SPEEDS_TO_LOOK_BACK:
            return []
        self._looked_back = True
        moves = [EarlierMove(self.speed_mps * ms / 1000, n, bare=bare) for (ms, bare), n in self._blind.items()]
        self.carried_ms += sum(ms * n for (ms, _), n in self._blind.items())
        self._blind.clear()
        self.travel_m += sum(move.all_m for move in moves)
        return moves

    def correct(self, residual_m: float | None) -> float:
        """Move the newest travel by what the tracked tubers say, None: nothing; returns it."""
        if residual_m is None:
            self.carried_ms += self._unseen_ms
        else:
            self.travel_m += residual_m
        return self.travel_m

    def _seen(self, heights: HeightMap) -> tuple[NDArray[np.float32], NDArray[np.complex64]]:
        """The raster, and the spectrum of its rows."""
        occupied = self._occupied(heights)
        return occupied, np.fft.rfft(occupied, self._length, axis=1).astype(np.complex64)

    def _occupied(self, heights: HeightMap) -> NDArray[np.float32]:
        k, m = self._belt.intrinsics, self._belt.belt_from_camera
        a, b, c, t = self._belt.height_coefficients()
        step = max(1, round(CELL_M * 1000 / heights.cell_mm))
        rotation = np.ascontiguousarray(m[:2, :3])
        return _raster(
            heights.height_mm, heights.stride, step, np.array([a, b, c, t]), np.array([k.fx, k.fy, k.cx, k.cy]),
            rotation, m[:2, 3].copy(), self._x0, self._y0, self._shape,
        )  # fmt: skip

    def _jump_back_m(self, shift_m: float, elapsed_s: float) -> float:
        """How far the load went against its way since the last frame, where no belt can; else 0."""
        speed_mps = self.speed_mps
        most_m = max(BACK_LEAST_M, max(BACK_MPS, BACK_SPEEDS * abs(speed_mps)) * elapsed_s)
        return abs(shift_m) if shift_m * speed_mps < 0 and abs(shift_m) > most_m else 0.0

    def _least_match(self, expected_m: float, elapsed_s: float) -> float:
        """Normalised correlation that a shift needs to be believed: more where the frames may share no belt."""
        if expected_m >= (1 - LEAST_OVERLAP) * self._shape[1] * CELL_M:
            return SURE_MATCH
        return FIRST_MATCH if not self._speeds and elapsed_s > FIRST_WITHIN_S else LEAST_MATCH

    def _shift(
        self,
        occupied: NDArray[np.float32],
        spectrum: NDArray[np.complex64],
        expected_m: float,
        reach_m: float,
        least: float,
    ) -> float | None:
        """Shift of this raster against the last one, metres, or None where none matches by `least`."""
        if self._last is None:
            return None
        _, before, before_spectrum = self._last
        if occupied.sum() < LEAST_CELLS or before.sum() < LEAST_CELLS:
            return None
        cells = self._shape[1]
        # Correlation along x, row by row, summed over the rows; both are padded to twice their length, so it is not
        # circular and a shift backwards stands at the end.
        product = np.fft.irfft((spectrum * np.conj(before_spectrum)).sum(axis=0), self._length)
        limit = min(int((1 - LEAST_OVERLAP) * cells), int(reach_m / CELL_M) + 2 if np.isfinite(reach_m) else cells)
        shifts = np.arange(-limit, limit + 1)
        # Load inside the overlap at every shift, from running sums: what has left the view must not count against it.
        energy_now = np.concatenate([[0.0], np.cumsum((occupied**2).sum(axis=0, dtype=np.float64))])
        energy_before = np.concatenate([[0.0], np.cumsum((before**2).sum(axis=0, dtype=np.float64))])
        now = energy_now[np.minimum(cells, cells + shifts)] - energy_now[np.maximum(0, shifts)]
        then = energy_before[np.minimum(cells, cells - shifts)] - energy_before[np.maximum(0, -shifts)]
        common = np.minimum(now, then)
        match = np.where(common >= LEAST_COMMON, product[shifts] / np.sqrt(np.maximum(now * then, 1.0)), 0.0)
        # Tubers in rows correlate at several shifts: of two good ones the one nearer to the last speed is taken.
        unlikely = np.minimum(np.abs(shifts * CELL_M - expected_m) / FAR_M, 1.0) * bool(self._speeds)
        preferred = match - FAR_COST * unlikely
        best = int(np.argmax(preferred))
        if match[best] < least or not 0 < best < len(shifts) - 1:
            return None
        # A parabola through the peak and its neighbours finds it between the cells.
        left, peak, right = (float(value) for value in match[best - 1 : best + 2])
        bend = left - 2 * peak + right
        fraction = float(np.clip(0.5 * (left - right) / bend, -0.5, 0.5)) if bend < 0 else 0.0
        return (float(shifts[best]) + fraction) * CELL_M


@kernel()
def _raster(
    height_mm: NDArray[np.float32],
    stride: int,
    step: int,
    heights: NDArray[np.float64],
    k: NDArray[np.float64],
    rotation: NDArray[np.float64],
    shift: NDArray[np.float64],
    x0: float,
    y0: float,
    shape: tuple[int, int],
) -> NDArray[np.float32]:
    """(across, along) float32 raster of the belt, 1 where load rises above 12 mm, its upper side dropped to the
    belt.
    """
    raster = np.zeros(shape, np.float32)
    a, b, c, t = heights
    half = (stride - 1) / 2.0
    for i in range(step // 2, height_mm.shape[0], step):
        for j in range(step // 2, height_mm.shape[1], step):
            h = height_mm[i, j]
            if h > OCCUPIED_MM:
                u, v = j * stride + half, i * stride + half
                z = (h * 1e-3 - t) / (a * u + b * v + c)
                x, y = (u - k[2]) / k[0] * z, (v - k[3]) / k[1] * z
                along = (rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z + shift[0] - x0) / CELL_M
                across = (rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z + shift[1] - y0) / CELL_M
                if 0 <= along < shape[1] and 0 <= across < shape[0]:
                    raster[int(across), int(along)] = 1.0
    return raster
