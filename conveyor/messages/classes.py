"""What of a load is of which class of its contract."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from conveyor.ranges import LoadGrams, Range, Word

Percent = Annotated[float, Range(0, 100, "%")]
Tubers = Annotated[float, Range(0, 1e15, "tubers")]
Edge = Annotated[float, Range(0, 256, "mm")]


@dataclass(frozen=True, slots=True)
class ClassTotal:
    """One class of a contract, as expected and with its 90 % interval.

    Attributes:
        from_mm, to_mm: its edges; None: without an upper one.
        count, count_low, count_high: tubers, expected ones: single tubers near an edge are of both sides in part.
        weight_g, low_g, high_g: what they weigh, of the weight that was seen.
        percent, percent_low, percent_high: of that weight.
        state: whether the contract's limits are 'kept', 'broken', or 'open' where the interval allows both; '' without.
    """

    name: Word
    from_mm: Edge
    to_mm: Edge | None
    count: Tubers
    count_low: Tubers
    count_high: Tubers
    weight_g: LoadGrams
    low_g: LoadGrams
    high_g: LoadGrams
    percent: Percent
    percent_low: Percent
    percent_high: Percent
    state: Literal["", "kept", "open", "broken"] = ""
