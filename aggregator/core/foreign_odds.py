"""How sure the classifier was of everything in a load, and with which chance each body is none: kept in bins, so that
it can be asked when the load is over.

A clod that is taken for a tuber is not one among equals: its log-odds lie far below those of the load's tubers. How far
is told by the tubers themselves, for a camera that is worse, or a belt that the classifier takes for cloddy, moves all
of them. Of what a single body says, and of how far it lies below the middle tuber, one logistic rule makes a chance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Self

STEP = 0.5
MOST = 20.0
"""Bins of half a unit of log-odds, within +-20: beyond, nothing is doubted any more."""

AT_NONE, BY_OWN, BY_BELOW = -3.05, -0.79, 0.65
"""Log-odds of other against tuber: `AT_NONE`, and for each unit of a body's own log-odds of tuber `BY_OWN`, for each
unit that they lie below the middle tuber's `BY_BELOW`. A logistic regression over the 42 belts of `benchmarks foreign`
with seeds below 69000 and, at a quarter of the weight, those of `benchmarks clods`: 7,600 tubers, 770 others. Ten belts
are as long as loads: on a long clean belt the segmenter's prior believes in tubers, and more clods are taken for them
than on a short one."""

USUAL_TUBER = 8.0
"""Log-odds of a middle tuber, where a load has none that was judged."""


@dataclass(frozen=True, slots=True)
class Doubt:
    """What a load's odds come to: `count` and `variance` of what is no tuber, refused or not; of these `hidden` were
    taken for tubers and weighed `hidden_g`. `spared_ml`: visible volume of tubers that were refused."""

    count: float
    variance: float
    hidden: float
    hidden_g: float
    spared_ml: float


@dataclass(slots=True)
class OddsBins:
    """By half a unit of log-odds: tubers, their grams, bodies refused, their visible volume in ml."""

    bins: dict[int, list[float]] = field(default_factory=dict)

    def add_tuber(self, log_odds: float, grams: float) -> None:
        """Count what was taken for a tuber."""
        self._put(_bin(log_odds), (1, grams, 0, 0.0))

    def add_body(self, log_odds: float, volume_ml: float) -> None:
        """Count what was refused."""
        self._put(_bin(log_odds), (0, 0.0, 1, volume_ml))

    def take(self, other: Self) -> None:
        """Add what `other` counted."""
        for at, (tubers, grams, bodies, volume_ml) in other.bins.items():
            self._put(at, (tubers, grams, bodies, volume_ml))

    def _put(self, at: int, more: tuple[float, float, float, float]) -> None:
        own = self.bins.setdefault(at, [0, 0.0, 0, 0.0])
        own[:] = [a + b for a, b in zip(own, more, strict=True)]

    def middle_tuber(self) -> float:
        """Median log-odds of what was taken for tubers."""
        left = sum(own[0] for own in self.bins.values()) / 2
        for at in sorted(self.bins):
            left -= self.bins[at][0]
            if left < 0:
                return _middle(at)
        return USUAL_TUBER

    def doubt(self) -> Doubt:
        """What of all this is no tuber."""
        count = variance = hidden = hidden_g = spared_ml = 0.0
        middle = self.middle_tuber()
        for at, (tubers, grams, bodies, volume_ml) in sorted(self.bins.items()):
            chance = chance_of_other(_middle(at), middle)
            count += chance * (tubers + bodies)
            variance += chance * (1 - chance) * (tubers + bodies)
            hidden += chance * tubers
            hidden_g += chance * grams
            spared_ml += (1 - chance) * volume_ml
        return Doubt(count, variance, hidden, hidden_g, spared_ml)


def chance_of_other(log_odds: float, middle_tuber: float) -> float:
    """Probability that a body is no tuber, where the load's middle tuber has those log-odds."""
    said = AT_NONE + BY_OWN * log_odds + BY_BELOW * (middle_tuber - log_odds)
    return 1 / (1 + math.exp(min(max(-said, -60.0), 60.0)))


def _bin(log_odds: float) -> int:
    return math.floor(min(max(log_odds, -MOST), MOST) / STEP)


def _middle(at: int) -> float:
    return (at + 0.5) * STEP
