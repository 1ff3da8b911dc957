"""Where bodies lie on the belt: a single layer in which nothing overlaps, from singulated to crowded.

The belt is filled backwards (towards -x). For each strip of 1 mm across the belt the front keeps how far back it is
taken; a body slides forwards until its outline meets it. Outlines are convex hulls seen from above, so bodies that do
not overlap there do not meet in space either.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

STRIP_M = 0.001


@dataclass(frozen=True, slots=True)
class Packing:
    """How tightly bodies lie.

    Attributes:
        tries: positions across the belt of which the foremost is taken; more are tighter.
        touching: share of bodies that slide until they touch (0.5 mm are left).
        gap_m: mean of the exponential gap that the others keep ahead; aside_m: free space kept at their sides.
    """

    tries: int
    touching: float
    gap_m: float
    aside_m: float


SINGULATED = Packing(tries=2, touching=0.0, gap_m=0.035, aside_m=0.018)
TOUCHING = Packing(tries=4, touching=0.7, gap_m=0.03, aside_m=0.0)
LOOSE = Packing(tries=3, touching=0.15, gap_m=0.05, aside_m=0.012)
CROWDED = Packing(tries=24, touching=0.95, gap_m=0.008, aside_m=0.0)
CONTACT_M = 0.0005
SINGLE_GAP_M = 0.015


class Lane:
    """A stretch across the belt from `low_m` to `high_m` that is filled backwards."""

    def __init__(self, low_m: float, high_m: float, *, packing: Packing, start_m: float = 0.0) -> None:
        self._low = low_m
        self._packing = packing
        self._front = np.full(max(1, round((high_m - low_m) / STRIP_M)), start_m)

    @property
    def rear_m(self) -> float:
        """How far back the lane is taken."""
        return float(self._front.min())

    def add(
        self, points: NDArray[np.float64], rng: Generator, *, settle: Callable[[float], float] | None = None
    ) -> tuple[float, float] | None:
        """(x, y) to move a body by, whose vertices are `points` (V, 3) in metres; None where it is too wide.

        `settle`: from the foremost x that is free to where the body comes to rest, there or further back.
        """
        packing = self._packing
        touches = rng.random() < packing.touching
        gap = CONTACT_M if touches else CONTACT_M + float(rng.exponential(packing.gap_m))
        if packing.aside_m > 0:
            gap += SINGLE_GAP_M
        ahead, behind = _outline(points)
        aside = round(packing.aside_m / STRIP_M) if not touches else 0
        room = len(self._front) - len(ahead)
        if room < 0:
            return None
        best_x, best_at = -np.inf, 0
        for at in rng.integers(0, room + 1, packing.tries).tolist():
            x = self._slide(ahead, at, aside) - gap
            if x > best_x:
                best_x, best_at = x, at
        if settle is not None:
            best_x = settle(best_x)
        self._front[best_at : best_at + len(ahead)] = best_x + behind
        y_low = float(np.floor(points[:, 1].min() / STRIP_M)) * STRIP_M
        return best_x, self._low + best_at * STRIP_M - y_low

    def _slide(self, ahead: NDArray[np.float64], at: int, aside: int) -> float:
        """How far forwards a body of outline `ahead` can go whose first strip is `at`."""
        x = float((self._front[at : at + len(ahead)] - ahead).min())
        if aside:
            beside = np.concatenate(
                [self._front[max(0, at - aside) : at], self._front[at + len(ahead) : at + len(ahead) + aside]]
            )
            if len(beside):
                x = min(x, float(beside.min() - ahead.max()))
        return x


def _outline(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(ahead, behind): largest and smallest x of the hull seen from above, for each strip of y that it touches."""
    flat = points[:, :2]
    corners = flat[ConvexHull(flat).vertices]
    first = int(np.floor(corners[:, 1].min() / STRIP_M))
    last = int(np.floor(corners[:, 1].max() / STRIP_M))
    edges = (np.arange(first, last + 2)) * STRIP_M
    start, end = corners, np.roll(corners, -1, axis=0)
    low_y, high_y = np.minimum(start[:, 1], end[:, 1]), np.maximum(start[:, 1], end[:, 1])
    y = np.clip(edges[:, None], low_y, high_y)
    share = (y - start[:, 1]) / np.where(np.abs(end[:, 1] - start[:, 1]) < 1e-12, 1.0, end[:, 1] - start[:, 1])
    x = start[:, 0] + np.clip(share, 0, 1) * (end[:, 0] - start[:, 0])
    touched = (low_y <= edges[:, None]) & (edges[:, None] <= high_y)
    ahead_at = np.where(touched, x, -np.inf).max(axis=1)
    behind_at = np.where(touched, x, np.inf).min(axis=1)
    ahead = np.maximum(ahead_at[:-1], ahead_at[1:])
    behind = np.minimum(behind_at[:-1], behind_at[1:])
    strip = np.clip(np.floor(corners[:, 1] / STRIP_M).astype(int) - first, 0, len(ahead) - 1)
    np.maximum.at(ahead, strip, corners[:, 0])
    np.minimum.at(behind, strip, corners[:, 0])
    return ahead, behind
