"""From the belt that each camera looked at, and the tubers that each set of cameras saw, to the share of tubers seen.

A lane is a set of cameras whose views hold a tuber's path across the belt. No one tells which lanes there are: where A
and B both looked, tubers that only A saw ride in A's lane; where only A looked they may ride in a lane of both. With
`a[O, S]` the belt on which of lane S's cameras exactly O looked, the counts are

    n[O] ~ Poisson(sum over S of a[O, S] * density[S])

and the densities follow by maximum likelihood (expectation maximisation), lanes of one camera held together by a few
tubers' worth of belief that they are equally full: a camera that looked at a hand's breadth of belt and saw no tuber
says nothing of its lane. Seen is density times the belt on which any camera of the lane looked.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

ROUNDS = 300
BELIEF_TUBERS = 3.0
"""That the lanes of one camera each are equally full is believed as firmly as if so many tubers had shown it."""
MOST_FOR_ALL_LANES = 4
"""With more cameras only the lanes of one camera, of neighbours by name, and those that were seen are thought of."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """Belt from `low` to `high`, metres, of which a share was looked at."""

    low: float
    high: float
    share: float

    @property
    def length_m(self) -> float:
        """Its length."""
        return self.high - self.low


def looked_lengths(stretches: Mapping[str, Sequence[Stretch]]) -> dict[frozenset[str], float]:
    """Belt length on which exactly that set of cameras looked, metres. Within a stretch of which a part was looked at,
    cameras are taken to have missed independently of each other.
    """
    edges = sorted({edge for own in stretches.values() for s in own for edge in (s.low, s.high)})
    middles = [(a + b) / 2 for a, b in pairwise(edges)]
    shares = {name: _shares_at(own, middles) for name, own in stretches.items()}
    lengths: dict[frozenset[str], float] = {}
    for at, (a, b) in enumerate(pairwise(edges)):
        parts: dict[frozenset[str], float] = {frozenset(): b - a}
        for name, share in shares.items():
            parts = _with(parts, name, share[at])
        for looking, length in parts.items():
            lengths[looking] = lengths.get(looking, 0.0) + length
    return lengths


def _shares_at(own: Sequence[Stretch], middles: Sequence[float]) -> list[float]:
    """The share looked at around each of the ascending `middles`; stretches follow each other."""
    found, at = [], 0
    for x in middles:
        while at < len(own) - 1 and own[at].high < x:
            at += 1
        found.append(own[at].share if own and own[at].low <= x <= own[at].high else 0.0)
    return found


def _with(parts: dict[frozenset[str], float], name: str, share: float) -> dict[frozenset[str], float]:
    if share <= 0:
        return parts
    split: dict[frozenset[str], float] = {}
    for looking, length in parts.items():
        split[looking | {name}] = split.get(looking | {name}, 0.0) + length * min(share, 1.0)
        if share < 1.0:
            split[looking] = split.get(looking, 0.0) + length * (1.0 - share)
    return split


def share_seen(
    lengths: Mapping[frozenset[str], float],
    *,
    belt_m: float,
    shares: Mapping[str, float],
    seen_by: Mapping[frozenset[str], int],
) -> float:
    """Share of the line's tubers that passed under a looking camera, 0 to 1.

    For a camera that never looked there is nothing to go by: it is taken to have had a lane of its own, as full as the
    others' in the mean. Without tubers the cameras' shares are averaged.
    """
    looking = sorted(name for name, share in shares.items() if share > 0)
    if not looking:
        return 0.0
    seeing = len(looking) / len(shares)
    counts = {group & frozenset(looking): 0.0 for group in seen_by}
    for group, n in seen_by.items():
        counts[group & frozenset(looking)] += n
    counts = {group: n for group, n in counts.items() if group and n}
    if not counts:
        return seeing * min(1.0, sum(shares[name] for name in looking) / len(looking))
    lanes = _lanes(looking, counts)
    exposure = np.array([sum(m for at, m in lengths.items() if at & lane) for lane in lanes])
    density = _densities(lanes, lengths, counts)
    expected = float(density.sum()) * belt_m
    return seeing * min(1.0, float(density @ exposure) / expected) if expected > 0 else 0.0


def _lanes(looking: Sequence[str], counts: Mapping[frozenset[str], float]) -> list[frozenset[str]]:
    if len(looking) <= MOST_FOR_ALL_LANES:
        return [frozenset(lane) for n in range(1, len(looking) + 1) for lane in combinations(looking, n)]
    some = {frozenset({name}) for name in looking} | {frozenset(pair) for pair in pairwise(looking)}
    return sorted(some | set(counts), key=sorted)


def _densities(
    lanes: Sequence[frozenset[str]], lengths: Mapping[frozenset[str], float], counts: Mapping[frozenset[str], float]
) -> np.ndarray:
    """(lanes,) float64 tubers per metre, by expectation maximisation from equal densities."""
    alone = np.array([len(lane) == 1 for lane in lanes])
    others = max(1, int(alone.sum()) - 1)
    belief = BELIEF_TUBERS * (alone if alone.sum() > 1 else np.zeros(len(lanes)))
    groups = sorted({lane & at for lane in lanes for at in lengths if lane & at} | set(counts), key=sorted)
    a = np.array(
        [[sum(m for at, m in lengths.items() if lane & at == group) for lane in lanes] for group in groups], np.float64
    )
    n = np.array([counts.get(group, 0.0) for group in groups])
    whole = a.sum(axis=0)
    density = np.full(len(lanes), n.sum() / max(a.sum(), 1e-9))
    for _ in range(ROUNDS):
        fitted = np.maximum(a @ density, 1e-12)
        elsewhere = np.maximum((density[alone].sum() - density) / others, 1e-12)
        found = density * (a.T @ (n / fitted)) + belief
        before, density = density, np.where(whole > 0, found / np.maximum(whole + belief / elsewhere, 1e-12), 0.0)
        if np.array_equal(before, density):
            break  # every further round gives the same
    return density
