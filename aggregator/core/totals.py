"""Totals of a load: weight with its interval, count, size classes, rate, and what the unseen belt adds.

Where tickets are at hand the load's weight is calibrated by them; the tubers in the ledger stay as weighed.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from aggregator.calibration.apply import Calibrated, calibrated, parts_percent
from aggregator.calibration.correction import Prior
from aggregator.calibration.sensitivity import tuber_g_per_mm
from aggregator.calibration.tickets import Ticket
from conveyor.messages import Totals, Tuber
from conveyor.statistics import NORMAL_90

UNSEEN_SPREAD = 0.5
"""Half of the 90 % interval of the weight on belt that was not looked at, as a share of it."""

RATE_WINDOW_S = 10.0
HISTOGRAM_CLASSES = 64
"""The last class takes everything heavier."""


@dataclass(slots=True)
class LoadTotals:
    """Running sums over committed tubers; the order of `add` changes nothing but the last digits.

    `as_weighed_g` is the sum of the tubers, by method and model; `weight_g` is that sum after calibration. By
    `per_mm_g` it grows for each millimetre that all of them lie lower. `prior` and `cultivar` are those of this run.
    """

    histogram_step_g: float
    tickets: Sequence[Ticket] = ()
    prior: Prior = field(default_factory=Prior)
    cultivar: str = ""
    count: int = 0
    as_weighed_g: dict[tuple[str, str], float] = field(default_factory=dict)
    per_mm_g: float = 0.0
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
        weighed_by = (tuber.method, tuber.model)
        self.as_weighed_g[weighed_by] = self.as_weighed_g.get(weighed_by, 0.0) + tuber.weight_g
        self.per_mm_g += tuber_g_per_mm(tuber)
        self.low_variance_g2 += ((tuber.weight_g - tuber.low_g) / NORMAL_90) ** 2
        self.high_variance_g2 += ((tuber.high_g - tuber.weight_g) / NORMAL_90) ** 2
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

    def calibrated(self) -> Calibrated:
        """What was seen by the tickets of its weights; without any, as weighed and as wide as what is not known."""
        return calibrated(
            self.as_weighed_g,
            per_mm_g=self.per_mm_g,
            own_variance_g2=(self.low_variance_g2, self.high_variance_g2),
            tickets=self.tickets,
            prior=self.prior,
            cultivar=self.cultivar,
        )

    @property
    def weight_g(self) -> float:
        """What was seen, calibrated where there are tickets."""
        return self.calibrated().weight_g

    @property
    def tickets_used(self) -> int:
        """Tickets of the weights that weighed this load; 0: it is not calibrated."""
        return self.calibrated().tickets

    def own_error_g(self) -> tuple[float, float]:
        """90 % half-widths, below and above, of the errors that tubers have for themselves, as weighed."""
        return NORMAL_90 * math.sqrt(self.low_variance_g2), NORMAL_90 * math.sqrt(self.high_variance_g2)

    def interval_g(self) -> tuple[float, float]:
        """The 90 % interval of the weight seen: each tuber's own error, and what all of them share."""
        seen = self.calibrated()
        return max(0.0, seen.weight_g - NORMAL_90 * seen.low_sd_g), seen.weight_g + NORMAL_90 * seen.high_sd_g

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
        seen = self.calibrated()
        return Totals(
            run=run,
            count=self.count,
            weight_g=seen.weight_g,
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
            as_weighed_g=sum(self.as_weighed_g.values()),
            tickets=seen.tickets,
            calibrated_by=seen.told,
            parts_percent=parts_percent(
                seen,
                estimated_g=estimated_g,
                low_g=estimated_low_g,
                high_g=estimated_high_g,
                coverage=min(coverage, 1.0) if coverage else 1.0,
            ),
        )

    def _rate(self) -> float:
        """Tubers per second over the last stretch of the cameras' time."""
        if len(self._recent_ns) < 2:
            return 0.0
        span_s = (max(self._recent_ns) - min(self._recent_ns)) / 1e9
        return (len(self._recent_ns) - 1) / span_s if span_s > 0 else 0.0
