"""How many views a second each regressor really weighs, from what it answers while it has work in hand."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field

REMEMBER_S = 8.0
"""What was measured this long ago counts a third."""
TRUSTED_BUSY_S = 0.3
LEAST_ANSWERS = 0.9
"""A rate is told once a regressor has been at work for so long, and has answered."""
SLOW_S = 6.0
"""Or at work for so much of the last `REMEMBER_S` without an answer: that is slow, and not unknown."""


@dataclass(slots=True)
class _Work:
    busy_s: float = 0.0
    answers: float = 0.0


@dataclass(slots=True)
class Throughput:
    """Answers per second of work, fading; a regressor without work in hand is not measured. Pure: time is a number."""

    turn_s: float = 0.0
    _work: dict[str, _Work] = field(default_factory=dict)
    _now_s: float | None = None

    def step(self, now_s: float, busy: Collection[str]) -> None:
        """Time went on; those `busy` had work in hand all along."""
        elapsed_s = 0.0 if self._now_s is None else max(0.0, now_s - self._now_s)
        self._now_s = now_s
        if elapsed_s == 0.0:
            return
        self.turn_s = elapsed_s if self.turn_s == 0.0 else self.turn_s + 0.1 * (elapsed_s - self.turn_s)
        fade = math.exp(-elapsed_s / REMEMBER_S)
        for name in busy:
            work = self._work.setdefault(name, _Work())
            work.busy_s = work.busy_s * fade + elapsed_s
            work.answers *= fade

    def answered(self, name: str) -> None:
        """One more answer came."""
        self._work.setdefault(name, _Work()).answers += 1

    def gone(self, name: str) -> None:
        """Forget a regressor: one that comes back under its name may be another machine."""
        self._work.pop(name, None)

    def rate_per_s(self, name: str) -> float | None:
        """Views a second of one regressor; None where it has not been at work for long enough to tell.

        One answer more than there were, for the one under way: what is slow is not taken for slower than it is.
        """
        work = self._work.get(name)
        if work is None or work.busy_s < TRUSTED_BUSY_S or (work.answers < LEAST_ANSWERS and work.busy_s < SLOW_S):
            return None
        return (work.answers + 1.0) / work.busy_s

    def total_per_s(self, names: Iterable[str]) -> float | None:
        """Views a second of several together; None where nothing is known of one of them, or there is none."""
        rates = [self.rate_per_s(name) for name in names]
        known = [rate for rate in rates if rate is not None]
        return sum(known) if known and len(known) == len(rates) else None
