"""The share of foreign matter in a load: bodies refused, corrected by what the classifier doubts, and their weight."""

from __future__ import annotations

import math

from aggregator.core.totals import LoadTotals
from conveyor.config_yield import CLOD_FILLED, ForeignConfig
from conveyor.messages.foreign import ForeignTotal
from conveyor.statistics import NORMAL_90

HIDDEN_SD, OF_ALL_SD = 0.6, 0.004
"""Standard deviations from load to load of how many others are taken for tubers: as a share of those that their odds
tell, and of all bodies. What sets a clod's odds apart differs from camera to camera and from clod to clod. On the
simulated day a third of all less missed two varieties of three."""
TUBER_G_ML, TUBER_FILLED = 1.07, 0.88
"""Of a tuber: density, and the part of the volume under its visible surface that is tuber."""
VOLUME_SD = 0.15
"""Of a load's foreign weight: standard deviation of filling, density and of what is clod and what is stone."""


def foreign_total(load: LoadTotals, densities: ForeignConfig, *, weight_g: float | None = None) -> ForeignTotal | None:
    """What of a load is no tuber; None where there are neither tubers nor others.

    `weight_g`: of all that was taken for tubers, where it is known better than `load` has it: of several loads, each by
    its own tickets.
    """
    found, tubers = load.sums.foreign, load.sums.count
    if not tubers and not found.count:
        return None
    doubt, total = found.odds.doubt(), tubers + found.count
    count = min(doubt.count + found.unasked, float(total))
    shared = math.hypot(HIDDEN_SD * doubt.hidden, OF_ALL_SD * total) if found.odds.bins else 0.0
    count_sd = math.hypot(math.sqrt(doubt.variance), shared)
    low, high = max(0.0, count - NORMAL_90 * count_sd), min(float(total), count + NORMAL_90 * count_sd)
    clod_g_ml = _clod_or_stone_g_ml(densities)
    haulm_ml = found.bodies.get("haulm", [0, 0.0])[1]
    clod_ml = found.bodies.get("lump", [0, 0.0])[1] - doubt.spared_ml
    # What was taken for a tuber and is a clod weighs by its volume too: its grams say what lies under its surface.
    hidden_g = CLOD_FILLED * clod_g_ml * doubt.hidden_g / (TUBER_FILLED * TUBER_G_ML)
    foreign_g = max(0.0, CLOD_FILLED * (clod_ml * clod_g_ml + haulm_ml * densities.haulm_density) + hidden_g)
    half_g = NORMAL_90 * math.hypot(VOLUME_SD * foreign_g, count_sd * foreign_g / max(count, 1.0))
    tubers_g = max(0.0, (load.weight_g if weight_g is None else weight_g) - doubt.hidden_g)
    low_g, high_g = max(0.0, foreign_g - half_g), foreign_g + half_g
    return ForeignTotal(
        count=count,
        count_low=low,
        count_high=high,
        percent=_percent(count, total - count),
        percent_low=_percent(low, total - low),
        percent_high=_percent(high, total - high),
        weight_g=foreign_g,
        low_g=low_g,
        high_g=high_g,
        weight_percent=_percent(foreign_g, tubers_g),
        weight_percent_low=_percent(low_g, tubers_g),
        weight_percent_high=_percent(high_g, tubers_g),
        kinds={kind: own[0] for kind, own in sorted(found.bodies.items())},
    )


def jacket_g(gross_g: float | None, net_g: float | None, foreign: ForeignTotal | None) -> float | None:
    """What a gross ticket says beyond the net one and the foreign matter: soil on tubers, and what is too small to see;
    None where a ticket is missing. Below zero: the foreign matter is told too heavy, or a scale is off.
    """
    if gross_g is None or net_g is None:
        return None
    return gross_g - net_g - (foreign.weight_g if foreign else 0.0)


def _clod_or_stone_g_ml(densities: ForeignConfig) -> float:
    """Density of a body of which depth does not say whether it is a clod or a stone."""
    stones = densities.stone_share
    return stones * densities.stone_density + (1 - stones) * densities.clod_density


def _percent(foreign: float, tubers: float) -> float:
    """0 to 100. The share first: 100 times a part over the whole rounds to more than 100 where the part is all."""
    return 100 * (foreign / (foreign + tubers)) if foreign + tubers > 0 else 0.0
