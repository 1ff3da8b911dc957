"""A load by the classes of a contract: count and weight of each with intervals, and whether its limits are kept."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from typing import Literal

import numpy as np

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
    return classes_together([load], contract)


def classes_together(
    loads: Sequence[LoadTotals], contract: Contract, *, whole: Sequence[float] | None = None
) -> tuple[ClassTotal, ...]:
    """The classes of several loads together, each calibrated by its own tickets; their errors in common do not shrink.

    Args:
        whole: by what the weight of each is multiplied for belt that was not seen; default: 1.
    """
    known = [
        (load, times, _shares(load, contract))
        for load, times in zip(loads, whole or [1.0] * len(loads), strict=True)
        if load.sums.sizes.bins[contract.measure]
    ]
    if not known:
        return ()
    count = sum(load.sums.count for load in loads)
    sized = sum(found.count for load, _, _ in known for found in load.sums.sizes.bins[contract.measure].values())
    counts = [float(load.sums.count) for load, _, _ in known]
    grams = [times * load.weight_g for load, times, _ in known]
    intervals_g = [load.interval_g() for load in loads]
    seen = _Seen(
        count=count,
        unsized=1 - sized / count,
        weight_g=sum(load.weight_g for load in loads),
        low_g=sum(low_g for low_g, _ in intervals_g),
        high_g=sum(high_g for _, high_g in intervals_g),
    )
    return tuple(
        _total(seen, each, _mean([shares[k] for _, _, shares in known], counts, grams))
        for k, each in enumerate(contract.classes)
    )


@dataclass(frozen=True, slots=True)
class _Seen:
    """What passed: tubers, the share of them without a size, and their weight with its interval."""

    count: int
    unsized: float
    weight_g: float
    low_g: float
    high_g: float


def _shares(load: LoadTotals, contract: Contract) -> list[Share]:
    bins = load.sums.sizes.bins[contract.measure]
    ratio, sd = _weight_known(load)
    return class_shares(bins, contract.classes, measure=contract.measure, weight_ratio=ratio, weight_sd=sd)


def _mean(shares: Sequence[Share], counts: Sequence[float], grams: Sequence[float]) -> Share:
    """One class in loads of so many tubers and grams: what single tubers are off by is independent, the rest is not."""
    of_count = np.array(counts) / sum(counts)
    of_weight = np.array(grams) / sum(grams) if sum(grams) > 0 else of_count
    rows = np.array([astuple(share) for share in shares]).T
    return Share(
        count=float(of_count @ rows[0]),
        count_own=float(np.linalg.norm(of_count * rows[1])),
        count_moved=float(of_count @ rows[2]),
        weight=float(of_weight @ rows[3]),
        weight_own=float(np.linalg.norm(of_weight * rows[4])),
        weight_moved=float(of_weight @ rows[5]),
    )


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


def _total(seen: _Seen, each: SizeClass, share: Share) -> ClassTotal:
    count_sd = math.hypot(share.count_sd, seen.unsized * math.sqrt(share.count * (1 - share.count)))
    weight_sd = math.hypot(share.weight_sd, seen.unsized * math.sqrt(share.weight * (1 - share.weight)))
    count_low, count_high = interval(share.count, count_sd)
    low, high = interval(share.weight, weight_sd)
    count, weight_g = seen.count, seen.weight_g
    below_g = math.hypot(NORMAL_90 * weight_sd * weight_g, share.weight * (weight_g - seen.low_g))
    above_g = math.hypot(NORMAL_90 * weight_sd * weight_g, share.weight * (seen.high_g - weight_g))
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
