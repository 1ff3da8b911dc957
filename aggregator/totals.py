"""Totals of a load: weight with its interval, count, size classes, rate, and what the unseen belt adds."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, field

from aggregator.fusion import Z90
from conveyor.messages import Totals, Tuber

SHARED_BIAS = {"pointraft": 0.05, "volume": 0.10}
"""Half of the 90 % interval of what all tubers of a load have in common (belt height, density, drift between seasons),
as a share of the weight; it does not shrink with the count. 5 % is what a load total can be without a calibration load;
blind between seasons published models drifted by 9 to 10 % (docs/ledger.md)."""

UNSEEN_SPREAD = 0.5
"""Half of the 90 % interval of the weight on belt that was not looked at, as a share of it."""

RATE_WINDOW_S = 10.0
HISTOGRAM_CLASSES = 64
"""The last class takes everything heavier."""


@dataclass(slots=True)
class LoadTotals:
    """Running sums over committed tubers; the order of `add` changes nothing but the last digits."""

    histogram_step_g: float
    count: int = 0
    weight_g: float = 0.0
    by_method_g: dict[str, float] = field(default_factory=dict)
    low_variance_g2: float = 0.0
    high_variance_g2: float = 0.0
    seen_by: Counter[frozenset[str]] = field(default_factory=Counter)
    merged: int = 0
    late: int = 0
    _classes: list[int] = field(default_factory=list)
    _recent_ns: deque[int] = field(default_factory=deque)

    def add(self, tuber: Tuber) -> None:
        """Count one committed tuber."""
        self.count += 1
        self.weight_g += tuber.weight_g
        self.by_method_g[tuber.method] = self.by_method_g.get(tuber.method, 0.0) + tuber.weight_g
        self.low_variance_g2 += ((tuber.weight_g - tuber.low_g) / Z90) ** 2
        self.high_variance_g2 += ((tuber.high_g - tuber.weight_g) / Z90) ** 2
        self.seen_by[frozenset(tuber.cameras)] += 1
        self.merged += len(tuber.tracks) > 1
        self.late += "late" in tuber.flags
        bin_ = min(int(max(tuber.weight_g, 0.0) / self.histogram_step_g), HISTOGRAM_CLASSES - 1)
        self._classes += [0] * (bin_ + 1 - len(self._classes))
        self._classes[bin_] += 1
        self._recent_ns.append(tuber.crossed_ns)
        newest = max(self._recent_ns[-1], self._recent_ns[0])
        while self._recent_ns and self._recent_ns[0] < newest - RATE_WINDOW_S * 1e9:
            self._recent_ns.popleft()

    def interval_g(self) -> tuple[float, float]:
        """The 90 % interval of the weight seen: each tuber's own error, and the bias that all of them share."""
        bias_g = sum(SHARED_BIAS.get(method, 0.10) * weight for method, weight in self.by_method_g.items())
        low_g = math.hypot(Z90 * math.sqrt(self.low_variance_g2), bias_g)
        high_g = math.hypot(Z90 * math.sqrt(self.high_variance_g2), bias_g)
        return max(0.0, self.weight_g - low_g), self.weight_g + high_g

    def estimated(self, coverage: float | None) -> tuple[float, float, float]:
        """(weight, low, high) in grams for the whole belt: what was seen over the share that was looked at."""
        low_g, high_g = self.interval_g()
        if not coverage or coverage >= 1.0:
            return self.weight_g, low_g, high_g
        whole_g = self.weight_g / coverage
        unseen_g = UNSEEN_SPREAD * (whole_g - self.weight_g)
        below_g = math.hypot((self.weight_g - low_g) / coverage, unseen_g)
        above_g = math.hypot((high_g - self.weight_g) / coverage, unseen_g)
        return whole_g, max(low_g, whole_g - below_g), whole_g + above_g

    def message(self, run: str, *, coverage: float | None, cameras: Mapping[str, str], final: bool) -> Totals:
        """The totals as published."""
        low_g, high_g = self.interval_g()
        estimated_g, estimated_low_g, estimated_high_g = self.estimated(coverage)
        return Totals(
            run=run,
            count=self.count,
            weight_g=self.weight_g,
            low_g=low_g,
            high_g=high_g,
            coverage=coverage,
            estimated_weight_g=estimated_g,
            estimated_low_g=estimated_low_g,
            estimated_high_g=estimated_high_g,
            tubers_per_s=self._rate(),
            histogram_step_g=self.histogram_step_g,
            histogram=tuple(self._classes),
            cameras=dict(cameras),
            final=final,
        )

    def _rate(self) -> float:
        """Tubers per second over the last stretch of the cameras' time."""
        if len(self._recent_ns) < 2:
            return 0.0
        span_s = (max(self._recent_ns) - min(self._recent_ns)) / 1e9
        return (len(self._recent_ns) - 1) / span_s if span_s > 0 else 0.0
