"""How many tubers, and how many grams of them, are of which size: kept by millimetre, so that any classes can be read.

What is kept does not grow with the load, and a contract may come or change when all its tubers have passed.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Self

from conveyor.messages import Sizes, Tuber

BINNED = ("length", "mesh")
"""Measures that contracts are by."""
BINS = 256
"""Bins of 1 mm from 0; the last takes everything larger."""


@dataclass(slots=True)
class Bin:
    """Tubers whose estimated size lies in one millimetre: how many, their grams, and sums of squares.

    `variance_mm2` is the sum of the variances of their sizes, `squares_g2` of their squared weights.
    """

    count: int = 0
    grams: float = 0.0
    variance_mm2: float = 0.0
    squares_g2: float = 0.0


@dataclass(slots=True)
class SizeBins:
    """By measure and millimetre; tubers of which no size is known are in none."""

    bins: dict[str, dict[int, Bin]] = field(default_factory=lambda: {measure: {} for measure in BINNED})

    def add(self, tuber: Tuber) -> None:
        """Count one committed tuber."""
        if tuber.sizes is not None:
            for measure in BINNED:
                self._add(measure, tuber.sizes, tuber.weight_g)

    def _add(self, measure: str, sizes: Sizes, weight_g: float) -> None:
        value_mm, sd_mm = sizes.of(measure)
        found = self.bins[measure].setdefault(min(int(value_mm), BINS - 1), Bin())
        found.count += 1
        found.grams += weight_g
        found.variance_mm2 += sd_mm**2
        found.squares_g2 += weight_g**2

    def take(self, other: Self) -> None:
        """Add what `other` counted."""
        for measure in BINNED:
            for at, more in other.bins[measure].items():
                found = self.bins[measure].setdefault(at, Bin())
                found.count += more.count
                found.grams += more.grams
                found.variance_mm2 += more.variance_mm2
                found.squares_g2 += more.squares_g2

    def plain(self) -> dict[str, Any]:
        """As JSON keeps it; every digit. Empty where nothing is known of any size."""
        if not any(self.bins.values()):
            return {}
        return {
            measure: [[at, b.count, b.grams, b.variance_mm2, b.squares_g2] for at, b in sorted(bins.items())]
            for measure, bins in self.bins.items()
        }

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> Self:
        """Back from `plain`."""
        return cls({measure: {row[0]: Bin(*row[1:]) for row in plain.get(measure, [])} for measure in BINNED})
