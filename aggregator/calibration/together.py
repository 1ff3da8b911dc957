"""The weight of several loads together, and its interval: what they share does not shrink with their number.

The resting level and the camera are one and the same in all loads, so their errors add up; a variety's own factor is
one in all loads of it. What differs from load to load, each tuber's own error, and belt that was not seen are
independent from load to load: their squares add up.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from aggregator.calibration.apply import CAMERA, RESTING, TUBERS, UNSEEN
from aggregator.core.totals import LEAST_COVERAGE, LoadTotals
from conveyor.statistics import NORMAL_90


@dataclass(frozen=True, slots=True)
class OneLoad:
    """A load to be added: its totals, the share of its belt that was seen, its variety; `most_m` as in `Coverage`."""

    totals: LoadTotals
    coverage: float | None
    belt_m: float
    variety: str = ""
    most_m: float | None = None

    @property
    def estimated(self) -> tuple[float, float, float]:
        """(weight, low, high) of its whole belt, grams."""
        return self.totals.estimated(self.coverage, belt_m=self.belt_m, most_m=self.most_m)

    @property
    def whole(self) -> float:
        """By what is multiplied what was seen, for all of its belt."""
        return 1.0 / max(self.coverage, LEAST_COVERAGE) if self.coverage and self.coverage < 1.0 else 1.0

    @property
    def scale(self) -> float:
        """By what each of its tubers is multiplied as weighed: calibration, and belt that was not seen."""
        raw_g = self.totals.sums.as_weighed_g
        return self.whole * self.totals.weight_g / raw_g if raw_g > 0 else self.whole

    @property
    def unseen_sd_g(self) -> float:
        """Standard deviation of the weight on belt that was not seen."""
        whole_g, _, high_g = self.estimated
        _, seen_high_g = self.totals.interval_g()
        seen_half_g = (seen_high_g - self.totals.weight_g) * self.whole
        return math.sqrt(max(0.0, (high_g - whole_g) ** 2 - seen_half_g**2)) / NORMAL_90


@dataclass(frozen=True, slots=True)
class Together:
    """Several loads: weight of what was seen, and for the whole belt with its 90 % interval, grams.

    Attributes:
        as_weighed_g: before any calibration, of what was seen.
        parts_percent: 90 % half-widths by cause, in percent of the estimate; their squares add up.
        tickets: evidence that the calibration rests on.
    """

    tubers: int
    as_weighed_g: float
    weight_g: float
    estimated_g: float
    low_g: float
    high_g: float
    coverage: float | None
    belt_m: float
    parts_percent: Mapping[str, float]
    tickets: int


def together(loads: Sequence[OneLoad]) -> Together:
    """The sum of `loads` and its interval."""
    found = [(load, load.totals.calibrated()) for load in loads]
    estimated_g = sum(load.whole * seen.weight_g for load, seen in found)
    shared = {name: sum(load.whole * seen.parts_g[name] for load, seen in found) for name in (RESTING, CAMERA)}
    varieties: dict[str, float] = {}
    for load, seen in found:
        own = math.sqrt(max(0.0, seen.parts_g[TUBERS] ** 2 - seen.own_g**2 - seen.between_g**2))
        varieties[load.variety] = varieties.get(load.variety, 0.0) + load.whole * own
    variety_g2 = sum(sd_g**2 for sd_g in varieties.values())
    between_g2 = sum((load.whole * seen.between_g) ** 2 for load, seen in found)
    unseen_g2 = sum(load.unseen_sd_g**2 for load in loads)
    own_g2 = [sum((load.whole * load.totals.own_error_g()[at] / NORMAL_90 * _scale(load)) ** 2 for load in loads)
              for at in (0, 1)]  # fmt: skip
    common_g2 = sum(sd_g**2 for sd_g in shared.values()) + variety_g2 + between_g2 + unseen_g2
    low_sd_g, high_sd_g = (math.sqrt(common_g2 + own) for own in own_g2)
    belt_m = sum(load.belt_m for load in loads)
    seen_m = sum((load.coverage or 0.0) * load.belt_m for load in loads)
    tubers_g = math.sqrt(variety_g2 + between_g2 + sum(own_g2) / 2)
    parts = {**shared, TUBERS: tubers_g, UNSEEN: math.sqrt(unseen_g2)}
    return Together(
        tubers=sum(load.totals.sums.count for load in loads),
        as_weighed_g=sum(load.totals.sums.as_weighed_g for load in loads),
        weight_g=sum(seen.weight_g for _, seen in found),
        estimated_g=estimated_g,
        low_g=max(0.0, estimated_g - NORMAL_90 * low_sd_g),
        high_g=estimated_g + NORMAL_90 * high_sd_g,
        coverage=seen_m / belt_m if belt_m > 0 else None,
        belt_m=belt_m,
        parts_percent={name: 100 * NORMAL_90 * sd_g / estimated_g for name, sd_g in parts.items()}
        if estimated_g > 0
        else {},
        tickets=max((seen.tickets for _, seen in found), default=0),
    )


def _scale(load: OneLoad) -> float:
    """By what the calibration multiplies a load, its tubers' own errors too."""
    raw_g = load.totals.sums.as_weighed_g
    return load.totals.weight_g / raw_g if raw_g > 0 else 1.0
