"""The weight of several loads together, and its interval: what they share does not shrink with their number.

The resting level and the camera are one and the same in all loads, so their errors add up; a variety's own factor is
one in all loads of it. Heaps of one line are taken to be alike: errors of what lies under others add up, too. What
differs from load to load, each tuber's own error, and belt that was not seen are independent from load to load: their
squares add up. Loads of several lines, each calibrated by its own tickets, are added as if they were of one line: that
is too wide rather than too narrow.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from aggregator.calibration.apply import CAMERA, LAYERS, RESTING, TUBERS, UNSEEN
from aggregator.core.totals import LoadTotals
from conveyor.statistics import NORMAL_90
from conveyor.typed_names import name_key


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
        return self.totals.whole(self.coverage, belt_m=self.belt_m)

    @property
    def scale(self) -> float:
        """By what each of its tubers is multiplied as weighed: calibration, what lies under others, belt not seen."""
        raw_g, there_g = self.totals.sums.as_weighed_g, self.totals.weight_g + self.totals.hidden().weight_g
        return self.whole * there_g / raw_g if raw_g > 0 else self.whole

    @property
    def saw(self) -> bool:
        """Some of its belt was looked at, or a tuber counted."""
        return self.totals.sums.count > 0 or bool(self.coverage)

    @property
    def reach_g(self) -> float:
        """90 % half-width, above alone, of what may lie on belt of which it is not known how far it moved."""
        there_g, _, high_g = self.estimated
        known_g = self.totals.estimated(self.coverage, belt_m=self.belt_m)[2]
        return math.sqrt(max(0.0, (high_g - there_g) ** 2 - (known_g - there_g) ** 2))


@dataclass(frozen=True, slots=True)
class Together:
    """Several loads: weight of what was seen, and for the whole belt with its 90 % interval, grams.

    Attributes:
        as_weighed_g: before any calibration, of what was seen.
        seen_g: 90 % interval of what was seen, up to all that lies under others, as `LoadTotals.interval_g`.
        parts_percent: 90 % half-widths by cause, in percent of the estimate; their squares add up.
        tickets: evidence that the calibration of a load rests on; of the one that has most.
    """

    tubers: int
    as_weighed_g: float
    weight_g: float
    seen_g: tuple[float, float]
    estimated_g: float
    low_g: float
    high_g: float
    coverage: float | None
    belt_m: float
    parts_percent: Mapping[str, float]
    tickets: int

    @property
    def saw(self) -> bool:
        """Some belt was looked at, or a tuber counted; without either there is no weight, which is not one of 0 kg."""
        return self.tubers > 0 or bool(self.coverage)


def together(loads: Sequence[OneLoad]) -> Together:
    """The sum of `loads` and its interval; of one load what it comes to by itself."""
    weight_g = sum(load.totals.weight_g for load in loads)
    estimated_g = sum(load.whole * (load.totals.weight_g + load.totals.hidden().weight_g) for load in loads)
    errors, seen = _errors(loads, whole=True, hidden=True), _errors(loads, whole=False, hidden=False)
    missed_g2 = sum(load.totals.missed_g(load.coverage, belt_m=load.belt_m) ** 2 for load in loads)
    reach_g2 = sum(load.reach_g**2 for load in loads)
    below_g = math.sqrt((NORMAL_90 * errors.low_sd_g) ** 2 + missed_g2)
    above_g = math.sqrt((NORMAL_90 * errors.high_sd_g) ** 2 + missed_g2 + reach_g2)
    seen_low_g = max(0.0, weight_g - NORMAL_90 * seen.low_sd_g)
    floor_g = seen_low_g if any(load.whole != 1.0 for load in loads) else 0.0
    belt_m = sum(load.belt_m for load in loads)
    seen_m = sum((load.coverage or 0.0) * load.belt_m for load in loads)
    parts = {**errors.parts_g, UNSEEN: math.sqrt(missed_g2 + reach_g2) / NORMAL_90}
    return Together(
        tubers=sum(load.totals.sums.count for load in loads),
        as_weighed_g=sum(load.totals.sums.as_weighed_g for load in loads),
        weight_g=weight_g,
        seen_g=(seen_low_g, _seen_high_g(loads, weight_g, seen)),
        estimated_g=estimated_g,
        low_g=max(0.0, floor_g, estimated_g - below_g),
        high_g=estimated_g + above_g,
        coverage=seen_m / belt_m if belt_m > 0 else None,
        belt_m=belt_m,
        parts_percent={name: 100 * NORMAL_90 * sd_g / estimated_g for name, sd_g in parts.items()}
        if estimated_g > 0
        else {},
        tickets=max((load.totals.tickets_used for load in loads), default=0),
    )


@dataclass(frozen=True, slots=True)
class _Errors:
    """Standard deviations of the sum, but for belt that was not seen: `parts_g` by cause, and all of them below and
    above.
    """

    parts_g: Mapping[str, float]
    low_sd_g: float
    high_sd_g: float


def _seen_high_g(loads: Sequence[OneLoad], weight_g: float, seen: _Errors) -> float:
    """Up to where what was seen reaches; what lies under others passed the camera, too."""
    high_g, hidden_g = weight_g + NORMAL_90 * seen.high_sd_g, sum(load.totals.hidden().weight_g for load in loads)
    if hidden_g <= 0:
        return high_g
    return max(high_g, weight_g + hidden_g + NORMAL_90 * _errors(loads, whole=False, hidden=True).high_sd_g)


def _errors(loads: Sequence[OneLoad], *, whole: bool, hidden: bool) -> _Errors:
    """Of the weight of the whole belt or of what was seen on it, with what lies under others or without."""
    shared = dict.fromkeys((RESTING, CAMERA, LAYERS), 0.0)
    varieties: dict[str, float] = {}
    between_g2, own_g2 = 0.0, [0.0, 0.0]
    for load in loads:
        found, under, times = load.totals.calibrated(), load.totals.hidden(), load.whole if whole else 1.0
        layers_g = math.hypot(under.support_sd_g, under.weight_sd_g if hidden else 0.0)
        for name, sd_g in ((RESTING, found.parts_g[RESTING]), (CAMERA, found.parts_g[CAMERA]), (LAYERS, layers_g)):
            shared[name] += times * sd_g
        own = math.sqrt(max(0.0, found.parts_g[TUBERS] ** 2 - found.own_g**2 - found.between_g**2))
        variety = name_key(load.variety)
        varieties[variety] = varieties.get(variety, 0.0) + times * own
        between_g2 += (times * found.between_g) ** 2
        scale = times * load.totals.scale / NORMAL_90
        own_g2 = [had + (scale * half_g) ** 2 for had, half_g in zip(own_g2, load.totals.own_error_g(), strict=True)]
    tubers_g2 = sum(sd_g**2 for sd_g in varieties.values()) + between_g2
    common_g2 = sum(sd_g**2 for sd_g in shared.values()) + tubers_g2
    parts = {name: sd_g for name, sd_g in shared.items() if sd_g > 0 or name != LAYERS}
    return _Errors(
        {**parts, TUBERS: math.sqrt(tubers_g2 + sum(own_g2) / 2)},
        *(math.sqrt(common_g2 + own) for own in own_g2),
    )
