"""What of a load is no tuber."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from conveyor.ranges import Items, LoadGrams, Range, Word

Percent = Annotated[float, Range(0, 100, "%")]
Bodies = Annotated[float, Range(0, 1e15, "bodies")]


@dataclass(frozen=True, slots=True)
class ForeignTotal:
    """Clods, stones and haulm of a tuber's size among a load, each with its 90 % interval.

    Attributes:
        count, count_low, count_high: bodies, as expected by what the classifier believes of each.
        percent, percent_low, percent_high: of all bodies, tubers included.
        weight_g, low_g, high_g: by their volume and the densities of the line's config.
        weight_percent, weight_percent_low, weight_percent_high: of the weight of all, tubers included.
        kinds: bodies as they were refused, by kind: 'lump' (a clod or a stone), 'haulm'.
    """

    count: Bodies
    count_low: Bodies
    count_high: Bodies
    percent: Percent
    percent_low: Percent
    percent_high: Percent
    weight_g: LoadGrams
    low_g: LoadGrams
    high_g: LoadGrams
    weight_percent: Percent
    weight_percent_low: Percent
    weight_percent_high: Percent
    kinds: Annotated[dict[Word, Bodies], Items(16)]
