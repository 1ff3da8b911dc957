"""Matches the ledger's places with the true ones, one to one, and says what the rest is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from aggregator.core.matching import one_to_one

Places = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Comparison:
    """Indexes: `pairs` (ledger, truth) with their distance, true ones `missed`, ledger ones `doubles` and `false`."""

    pairs: tuple[tuple[int, int], ...]
    apart_m: tuple[float, ...]
    missed: tuple[int, ...]
    doubles: tuple[int, ...]
    false: tuple[int, ...]


def compare(ledger_m: Places, truth_m: Places, *, gate_m: float, half_lengths_m: NDArray[np.float64]) -> Comparison:
    """Match places at most `gate_m` apart, nearest in sum.

    A ledger tuber without a partner is a double where a true one lies within the gate or half of that one's length (the
    other end of a tuber that was split); else it is false.

    Args:
        ledger_m, truth_m: (n, 2) and (m, 2) float64, x and y on the belt, metres.
        half_lengths_m: (m,) float64, half of each true tuber's longest axis, metres.
    """
    pairs = sorted(_pairs(ledger_m, truth_m, gate_m))
    with_partner = {i for i, _ in pairs}
    found = {j for _, j in pairs}
    alone = [i for i in range(len(ledger_m)) if i not in with_partner]
    reach_m = np.maximum(gate_m, half_lengths_m)
    doubles = [i for i in alone if np.any(_apart(ledger_m[i], truth_m) <= reach_m)]
    return Comparison(
        pairs=tuple(pairs),
        apart_m=tuple(float(_apart(ledger_m[i], truth_m[j : j + 1])[0]) for i, j in pairs),
        missed=tuple(j for j in range(len(truth_m)) if j not in found),
        doubles=tuple(doubles),
        false=tuple(i for i in alone if i not in set(doubles)),
    )


def _pairs(ledger_m: Places, truth_m: Places, gate_m: float) -> list[tuple[int, int]]:
    """One-to-one pairs, solved for each cluster of places that are near each other."""
    if not len(ledger_m) or not len(truth_m):
        return []
    near = cKDTree(ledger_m).query_ball_tree(cKDTree(truth_m), gate_m)
    rows = np.array([i for i, js in enumerate(near) for _ in js], dtype=np.int64)
    columns = np.array([j for js in near for j in js], dtype=np.int64)
    size = len(ledger_m) + len(truth_m)
    graph = coo_array((np.ones(len(rows)), (rows, columns + len(ledger_m))), shape=(size, size))
    _, cluster = connected_components(graph, directed=False)
    members: dict[int, tuple[list[int], list[int]]] = {}
    for i in sorted(set(rows.tolist())):
        members.setdefault(int(cluster[i]), ([], []))[0].append(i)
    for j in sorted(set(columns.tolist())):
        members[int(cluster[j + len(ledger_m)])][1].append(j)
    pairs: list[tuple[int, int]] = []
    for left, right in members.values():
        cost = np.array([_apart(ledger_m[i], truth_m[right]) for i in left]) / (gate_m * (1 + 1e-9))
        pairs += [(left[a], right[b]) for a, b in one_to_one(cost)]
    return pairs


def _apart(place_m: Places, others_m: Places) -> NDArray[np.float64]:
    """Distances of one place from others, metres."""
    return np.asarray(np.hypot(others_m[:, 0] - place_m[0], others_m[:, 1] - place_m[1]), dtype=np.float64)
