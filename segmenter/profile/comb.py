"""The step of a camera's disparity, found from the depths that occur: they are f B / (n * step), n whole numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel

KNOWN_BASELINES_M = {"D405": 0.018, "D415": 0.055, "D435": 0.050, "D455": 0.095}
"""Distance of the imagers by RealSense model."""
STEPS_PER_PX = (1, 2, 4, 8, 16, 32, 64)
AROUND = 0.03
"""Share by which focal length times baseline may differ from what model and intrinsics say."""
FINEST = 4e-5
"""Share between two combs that are tried: at 1/32 px and a disparity of 50 px the last tooth moves by 0.06."""
FEWEST_VALUES, FEWEST_TEETH = 30, 8
"""Depth values between the nearest and the farthest that occur often, and teeth of a comb there: over fewer, some comb
matches by chance."""
LEAST_MATCH = 0.25
"""Correlation of the depths that occur with the comb: 0.93 on a real D435, 0.97 on a simulated D405 in units of 0.1 mm,
0.26 to 0.51 in units of 1 mm, which hide most of it."""
ENOUGH = 50.0
"""Occurrences from which on chance no longer hides the comb: more add no weight, so that a belt does not drown a load
whose many depths tell one comb from another."""
CLEARLY, SAME_TEETH = 0.8, 0.01
"""Of the best match that the second best may reach: over a flat belt alone, in units coarser than the steps, combs of
very different cameras look alike. Combs whose teeth differ by less than the second are the same."""
SMOOTH_OVER = 15
"""Values over which how often depths occur is smoothed: what the scene does, the comb is in what is left."""


@dataclass(frozen=True, slots=True)
class Comb:
    """The depths of a camera are `focal_baseline` / (n / steps_per_px).

    Attributes:
        baseline_m: by the focal length that the recording states.
        match: correlation of the depths that occur with the comb's, 0 to 1.
    """

    steps_per_px: int
    baseline_m: float
    focal_baseline: float
    match: float


def find_comb(
    counts: NDArray[np.int64], *, depth_scale_m: float, focal_px: float, baselines_m: Sequence[float]
) -> Comb | None:
    """The comb that explains best which depths occur; None where none does, or the unit is too coarse to show one.

    Args:
        counts: (n,) how often each depth value occurs, `counts[0]` of no depth.
        depth_scale_m: metres per depth value.
        baselines_m: those that the camera may have.
    """
    values = np.flatnonzero(counts[1:] >= ENOUGH) + 1
    if not len(values) or values[-1] - values[0] < FEWEST_VALUES:
        return None
    low, high = int(values[0]), int(values[-1])
    seen = counts[low : high + 1].astype(np.float64)
    weight = np.asarray(np.convolve(seen, np.ones(SMOOTH_OVER) / SMOOTH_OVER, mode="same"), np.float64)
    share = np.where(weight > 0, seen / np.maximum(weight, 1e-9) - 1, 0.0)
    weight = weight / (weight + ENOUGH)
    edges = np.asarray(1.0 / (np.arange(low, high + 2) - 0.5), np.float64)
    found: list[Comb] = []
    for baseline_m in baselines_m:
        for steps in STEPS_PER_PX:
            teeth = focal_px * baseline_m * steps / depth_scale_m
            if teeth * (edges[0] - edges[-1]) < FEWEST_TEETH:
                continue
            tried = np.asarray(teeth * (1 + np.arange(-AROUND, AROUND, FINEST)), dtype=np.float64)
            matches = _matches(tried, edges, share, weight)
            at = int(np.argmax(matches))
            focal_baseline = float(tried[at] * depth_scale_m / steps)
            found.append(Comb(steps, focal_baseline / focal_px, focal_baseline, float(matches[at])))
    return _clearly_best(found)


def _clearly_best(found: list[Comb]) -> Comb | None:
    """The comb that matches best; None where another one, with other teeth, does nearly as well.

    A finer one of the same camera has all of the best one's teeth and more: that it matches, too, is no doubt.
    """
    best = max(found, key=lambda comb: comb.match, default=None)
    if best is None or best.match < LEAST_MATCH:
        return None
    teeth = best.focal_baseline * best.steps_per_px
    others = [c for c in found if abs(c.focal_baseline * c.steps_per_px / teeth - 1) > SAME_TEETH]
    rivals = [c.match for c in others if not _finer(c, best)]
    return best if max(rivals, default=0.0) < CLEARLY * best.match else None


def _finer(comb: Comb, than: Comb) -> bool:
    """The same camera's comb with more steps to a pixel."""
    same = abs(comb.focal_baseline / than.focal_baseline - 1) <= SAME_TEETH
    return same and comb.steps_per_px > than.steps_per_px


@kernel()
def _matches(
    tried: NDArray[np.float64], edges: NDArray[np.float64], share: NDArray[np.float64], weight: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(t,) weighted correlation of each comb's teeth per depth value, against their mean density, with `share`."""
    out = np.zeros(len(tried))
    n = len(share)
    total = weight.sum()
    for t in range(len(tried)):
        sx = sy = sxx = syy = sxy = 0.0
        for i in range(n):
            first, last = tried[t] * edges[i], tried[t] * edges[i + 1]
            x = (np.floor(first) - np.floor(last)) / (first - last) - 1.0
            y = share[i]
            w = weight[i]
            sx += w * x
            sy += w * y
            sxx += w * x * x
            syy += w * y * y
            sxy += w * x * y
        vx, vy = sxx - sx * sx / total, syy - sy * sy / total
        if vx > 1e-9 * total and vy > 1e-9 * total:
            out[t] = (sxy - sx * sy / total) / np.sqrt(vx * vy)
    return out
