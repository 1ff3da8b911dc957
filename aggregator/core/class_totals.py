"""A load by the classes of a contract: count and weight of each with intervals, and whether its limits are kept."""

from __future__ import annotations

import math
from typing import Literal

from aggregator.calibration.apply import CAMERA, RESTING
from aggregator.core.size_classes import Share, class_shares, interval
from aggregator.core.totals import LoadTotals
from conveyor.contract import Contract, SizeClass
from conveyor.messages import ClassTotal
from conveyor.statistics import NORMAL_90

State = Literal["", "kept", "open", "broken"]


def class_totals(load: LoadTotals, contract: Contract) -> tuple[ClassTotal, ...]:
    """Every class of `contract`; none where no tuber of the load has a size.

    Tubers without a size are taken to be like the others, as far as one may know that. What tickets say of the weights
    they say of the sizes.
    """
    bins = load.sums.sizes.bins[contract.measure]
    sized = sum(found.count for found in bins.values())
    if not sized:
        return ()
    unsized = 1 - sized / load.sums.count
    ratio, sd = _weight_known(load)
    shares = class_shares(bins, contract.classes, measure=contract.measure, weight_ratio=ratio, weight_sd=sd)
    return tuple(_total(load, each, share, unsized) for each, share in zip(contract.classes, shares, strict=True))


def _weight_known(load: LoadTotals) -> tuple[float, float]:
    """(by what tickets multiply a tuber's weight, what all weights may still be off by: standard deviation, share).

    The scale was without the clods that were taken for tubers and weighed with them.
    """
    seen, raw_g = load.calibrated(), load.sums.as_weighed_g
    if raw_g <= 0 or seen.weight_g <= 0:
        return 1.0, 0.0
    tubers_g = raw_g - load.sums.foreign.odds.doubt().hidden_g if load.tickets_used else raw_g
    sd = math.hypot(seen.parts_g[RESTING], seen.parts_g[CAMERA]) / seen.weight_g
    return seen.weight_g / max(tubers_g, 0.5 * raw_g), sd


def _total(load: LoadTotals, each: SizeClass, share: Share, unsized: float) -> ClassTotal:
    count_sd = math.hypot(share.count_sd, unsized * math.sqrt(share.count * (1 - share.count)))
    weight_sd = math.hypot(share.weight_sd, unsized * math.sqrt(share.weight * (1 - share.weight)))
    count_low, count_high = interval(share.count, count_sd)
    low, high = interval(share.weight, weight_sd)
    count, weight_g = load.sums.count, load.weight_g
    low_g, high_g = load.interval_g()
    below_g = math.hypot(NORMAL_90 * weight_sd * weight_g, share.weight * (weight_g - low_g))
    above_g = math.hypot(NORMAL_90 * weight_sd * weight_g, share.weight * (high_g - weight_g))
    return ClassTotal(
        name=each.name,
        from_mm=each.low_mm,
        to_mm=each.to_mm,
        count=share.count * count,
        count_low=count_low * count,
        count_high=count_high * count,
        weight_g=share.weight * weight_g,
        low_g=max(0.0, share.weight * weight_g - below_g),
        high_g=share.weight * weight_g + above_g,
        percent=_percent(share.weight),
        percent_low=_percent(low),
        percent_high=_percent(high),
        state=_state(each, _percent(low), _percent(high)),
    )


def _percent(share: float) -> float:
    return min(100.0, max(0.0, 100 * share))


def _state(each: SizeClass, low: float, high: float) -> State:
    """What the interval of a class's percentage says of its limits."""
    least, most = each.at_least_percent, each.at_most_percent
    if least is None and most is None:
        return ""
    least, most = least or 0.0, 100.0 if most is None else most
    if least <= low and high <= most:
        return "kept"
    return "broken" if high < least or low > most else "open"
