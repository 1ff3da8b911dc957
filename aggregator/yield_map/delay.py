"""How long the crop takes from the ground to the camera, found from the yields themselves.

Two rules of nature, independent of each other. Neighbouring ground yields alike: with the right delay, passes driven in
opposite directions agree, with a wrong one each is shifted its own way. And nothing is lifted while the machine stands:
the flow stops and starts `delay` after the machine.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from aggregator.yield_map.points import SLOWEST_M_S, Crop, pass_numbers
from aggregator.yield_map.track import Path

STEP_S = 1.0
SEARCH_S = (-20.0, 90.0)
OPPOSITE = -0.9
"""Cosine between headings of passes that count as opposite."""
NEAR_WIDTHS = 2.5
"""Passes count as neighbours up to here: with a second machine between them they lie two widths apart."""
MOST_PAIRS = 40_000
MOST_SECONDS = 20_000
RESAMPLES = 60
SMOOTH_S = 5
LEAST_PAIRS = 200


@dataclass(frozen=True, slots=True)
class Delay:
    """A delay that was found: seconds, its standard deviation, by which rule, and how much it explains.

    `sharpness`: the mean disagreement 10 s beside the minimum over the one at it; 1 says that the data do not tell.
    """

    delay_s: float
    sd_s: float
    by: str
    sharpness: float


@dataclass(frozen=True, slots=True, eq=False)
class _Seconds:
    """The path second by second, with the flow past the camera."""

    time_s: NDArray[np.float64]
    xy_m: NDArray[np.float64]
    heading_rad: NDArray[np.float64]
    speed_m_s: NDArray[np.float64]
    known: NDArray[np.bool_]
    flow_kg_s: NDArray[np.float64]

    def flow_at(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.interp(time_s, self.time_s, self.flow_kg_s, left=np.nan, right=np.nan)


def delays(path: Path, crop: Crop, *, width_m: float, seed: int = 0) -> list[Delay]:
    """What each rule finds, the most certain first; a rule that has too little to go by finds nothing."""
    seconds = _by_seconds(path, crop)
    rng = np.random.default_rng(seed)
    found = [_by_neighbours(seconds, width_m=width_m, rng=rng), _by_starts(seconds, rng=rng)]
    return sorted((delay for delay in found if delay is not None), key=lambda delay: delay.sd_s)


def _by_seconds(path: Path, crop: Crop) -> _Seconds:
    low, high = min(path.time_s[0], crop.time_s.min()), max(path.time_s[-1], crop.time_s.max())
    edges = np.arange(low, high + STEP_S, STEP_S)
    middle = (edges[:-1] + edges[1:]) / 2
    kg = np.histogram(crop.time_s, bins=edges, weights=crop.kg)[0]
    kernel = np.ones(SMOOTH_S) / SMOOTH_S
    known = path.known(middle)
    heading = path.heading_at(middle)
    speed = np.where(known, np.interp(middle, path.time_s, path.speed_m_s), 0.0)
    return _Seconds(middle, path.at(middle), heading, speed, known, np.convolve(kg, kernel, mode="same") / STEP_S)


def _by_neighbours(seconds: _Seconds, *, width_m: float, rng: np.random.Generator) -> Delay | None:
    """Opposite passes beside each other: the delay at which they differ least, in mean square of their flow."""
    passes = pass_numbers(seconds.time_s, seconds.heading_rad, seconds.speed_m_s, seconds.known)
    on_pass = np.flatnonzero(passes >= 0)
    if len(on_pass) < 2:
        return None
    every = max(1, len(on_pass) // MOST_SECONDS)
    on_pass = on_pass[::every]
    pairs = cKDTree(seconds.xy_m[on_pass]).query_pairs(NEAR_WIDTHS * width_m, output_type="ndarray")
    first, second = on_pass[pairs[:, 0]], on_pass[pairs[:, 1]]
    cosine = np.cos(seconds.heading_rad[first] - seconds.heading_rad[second])
    opposite = (passes[first] != passes[second]) & (cosine < OPPOSITE)
    first, second = first[opposite], second[opposite]
    if len(first) < LEAST_PAIRS:
        return None
    chosen = rng.permutation(len(first))[:MOST_PAIRS]
    first, second = first[chosen], second[chosen]
    grid = np.arange(SEARCH_S[0], SEARCH_S[1] + 0.25, 0.5)
    # Grouped by pair of passes: what lies on one pair is alike, so pairs of passes are what is drawn again.
    group = passes[first] * (passes.max() + 1) + passes[second]
    names, index = np.unique(group, return_inverse=True)
    sums = np.zeros((len(grid), len(names)))
    counts = np.zeros((len(grid), len(names)))
    for row, delay_s in enumerate(grid):
        flow = seconds.flow_at(seconds.time_s + delay_s)  # once a second, for many pairs have each of them
        difference = flow[first] - flow[second]
        there = np.isfinite(difference)
        sums[row] = np.bincount(index[there], weights=difference[there] ** 2, minlength=len(names))
        counts[row] = np.bincount(index[there], minlength=len(names))
    return _least(grid, sums, counts, by="opposite passes", rng=rng)


def _by_starts(seconds: _Seconds, *, rng: np.random.Generator) -> Delay | None:
    """Standing and going: the delay at which 'something flows' and 'the machine goes' differ in the fewest seconds."""
    going = seconds.speed_m_s > max(SLOWEST_M_S, 0.2 * float(np.median(seconds.speed_m_s[seconds.known])))
    changes = np.flatnonzero(np.diff(going.astype(int)) != 0)
    if len(changes) < 6:
        return None
    busy = seconds.flow_kg_s > 0.15 * float(np.median(seconds.flow_kg_s[seconds.flow_kg_s > 0]))
    flows = np.where(busy, 1.0, 0.0)
    grid = np.arange(SEARCH_S[0], SEARCH_S[1] + 0.25, 0.5)
    blocks = np.searchsorted(changes, np.arange(len(going))) // 2  # a stop and a start are drawn together
    sums = np.zeros((len(grid), int(blocks.max()) + 1))
    counts = np.zeros_like(sums)
    for row, delay_s in enumerate(grid):
        flow = np.interp(seconds.time_s + delay_s, seconds.time_s, flows, left=np.nan, right=np.nan)
        there = np.isfinite(flow) & seconds.known
        sums[row] = np.bincount(blocks[there], weights=(flow - going)[there] ** 2, minlength=sums.shape[1])
        counts[row] = np.bincount(blocks[there], minlength=sums.shape[1])
    return _least(grid, sums, counts, by="starts and stops", rng=rng)


def _least(
    grid: NDArray[np.float64],
    sums: NDArray[np.float64],
    counts: NDArray[np.float64],
    *,
    by: str,
    rng: np.random.Generator,
) -> Delay | None:
    """The minimum of the mean over all groups, with its spread when groups are drawn again.

    Delays at which less than half of the seconds can be compared are not looked at.
    """
    enough = counts.sum(axis=1) >= 0.5 * counts.sum(axis=1).max()
    grid, sums, counts = grid[enough], sums[enough], counts[enough]
    cost = sums.sum(axis=1) / counts.sum(axis=1)
    best = _vertex(grid, cost)
    drawn = []
    for _ in range(RESAMPLES):
        weights = rng.exponential(size=sums.shape[1])  # a few groups drawn whole would at times be one and the same
        drawn.append(_vertex(grid, (sums @ weights) / np.maximum(counts @ weights, 1e-9)))
    low = cost.min()
    beside = np.interp([best - 10, best + 10], grid, cost).mean()
    sharpness = float(beside / low) if low > 0 else float("inf")
    at_edge = best <= grid[0] + 0.5 or best >= grid[-1] - 0.5
    early, late = np.percentile(drawn, [16, 84])
    return None if at_edge else Delay(best, float(late - early) / 2, by, sharpness)


def _vertex(grid: NDArray[np.float64], cost: NDArray[np.float64]) -> float:
    """Where a parabola through the lowest value and its neighbours has its bottom."""
    i = int(np.argmin(cost))
    if i in (0, len(grid) - 1):
        return float(grid[i])
    left, middle, right = cost[i - 1 : i + 2]
    bend = left - 2 * middle + right
    shift = 0.0 if bend <= 0 else 0.5 * (left - right) / bend
    return float(grid[i] + shift * (grid[1] - grid[0]))
