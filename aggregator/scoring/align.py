"""Puts the ledger's places over the truth's where belt travel was estimated: another zero, and up to 1 % of drift.

Truth place = `scale` * ledger place + `offset_m`. The scale is searched in small steps; for each one the offset is the
fullest bin of all differences between truth and ledger places that lie side by side across the belt; the best pair is
then refined by least squares over its matches. Robust: wrong differences spread over all bins, right ones fall in one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

SCALES = np.linspace(0.97, 1.03, 61)
BIN_M = 0.01
REFINE_ROUNDS = 5


@dataclass(frozen=True, slots=True)
class Alignment:
    """Truth place along the belt = `scale` * ledger place + `offset_m`."""

    scale: float = 1.0
    offset_m: float = 0.0

    def applied(self, places_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 2) places of the ledger as places of the truth."""
        return np.column_stack([self.scale * places_m[:, 0] + self.offset_m, places_m[:, 1]])


def align(ledger_m: NDArray[np.float64], truth_m: NDArray[np.float64], *, gate_m: float) -> Alignment:
    """The alignment that puts most of the ledger's places within `gate_m` of a true one.

    Args:
        ledger_m, truth_m: (n, 2) and (m, 2) float64, places x, y on the belt, metres.
    """
    beside = np.abs(ledger_m[:, None, 1] - truth_m[None, :, 1]) < gate_m
    rows, columns = np.nonzero(beside)
    if rows.size < 2:
        return Alignment()
    best, most = Alignment(), -1
    for scale in SCALES:
        offset_m, votes = _fullest(truth_m[columns, 0] - scale * ledger_m[rows, 0])
        if votes > most:
            best, most = Alignment(float(scale), offset_m), votes
    return _refined(best, ledger_m, truth_m, gate_m=gate_m)


def _fullest(differences_m: NDArray[np.float64]) -> tuple[float, int]:
    """Centre of the fullest pair of neighbouring bins, and how many differences fall into it."""
    bins, counts = np.unique(np.floor((differences_m - differences_m.min()) / BIN_M), return_counts=True)
    counts_at = dict(zip(bins.tolist(), counts.tolist(), strict=True))
    last = max(bins[-1] - 1, 0)
    starts = [start for start in np.union1d(bins - 1, bins).tolist() if 0 <= start <= last]
    pairs = [counts_at.get(start, 0) + counts_at.get(start + 1, 0) for start in starts]
    at = int(np.argmax(pairs))
    return float(differences_m.min() + (starts[at] + 1) * BIN_M), pairs[at]


def _refined(
    start: Alignment, ledger_m: NDArray[np.float64], truth_m: NDArray[np.float64], *, gate_m: float
) -> Alignment:
    tree = cKDTree(truth_m)
    found = start
    for _ in range(REFINE_ROUNDS):
        apart_m, at = tree.query(found.applied(ledger_m), distance_upper_bound=gate_m)
        nearest = np.asarray(at, dtype=np.int64)
        inside = np.isfinite(apart_m)
        if inside.sum() < 3 or np.ptp(ledger_m[inside, 0]) < 1e-6:
            return found
        scale, offset_m = np.polyfit(ledger_m[inside, 0], truth_m[nearest[inside], 0], 1)
        found = Alignment(float(scale), float(offset_m))
    return found
