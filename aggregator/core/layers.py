"""More than one layer: what tubers that lie on others hide, how much of the belt is so, and how well that is known.

A tuber on others is weighed from its own underside up. What lies below it is hidden or cut off from view: the space
under it, filled as far as heaps are. How far that is was fitted to simulated heaps; another heap may be looser.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Self

from conveyor.layers import support_mm_of
from conveyor.messages import Tuber

# Fitted to 26 simulated heaps of 60 tubers, seeds 7101 to 7326, as the segmenter reads them; judged on others
# (docs/layers.md).
HIDDEN_G_PER_ML = 0.37
"""Grams hidden per millilitre of space under tubers that lie on others: from 0.15 to 0.7 in single heaps. More: the
estimate is heavier."""
HIDDEN_TUBERS_PER_ML = 0.0026
"""Tubers not counted per millilitre of that space: from 0.0012 to 0.0059."""
HIDDEN_SD = 0.4
"""Of the hidden weight, as a share of it: how unlike one another heaps are, standard deviation."""
SUPPORT_SD = 0.08
"""Of the weight of tubers that lie on others, as a share of it: what their heights are misjudged by together."""
LEAST_TUBERS, LEAST_SHARE = 3, 0.03
"""Tubers that lie on others, and their share of the load: below it the belt counts as one layer."""
OUTLINE = 1.14
"""Length times width in the ledger over that of the tuber itself (`aggregator.calibration.sensitivity`)."""
STRETCH_M = 0.1
"""Belt is told apart in stretches of this length."""
RUNS = 256
"""Runs of stretches that are told apart; beyond it the nearest neighbours become one."""


@dataclass(slots=True)
class LayerSums:
    """Sums over the tubers that lie on others. `runs` are (first, last) stretches of belt with such, ascending."""

    count: int = 0
    weight_g: float = 0.0
    under_ml: float = 0.0
    runs: list[tuple[int, int]] = field(default_factory=list)

    def add(self, tuber: Tuber) -> None:
        """Take one committed tuber; one on the belt changes nothing."""
        support_mm = support_mm_of(tuber.flags)
        if support_mm <= 0:
            return
        self.count += 1
        self.weight_g += tuber.weight_g
        self.under_ml += math.pi / 4 * tuber.length_mm * tuber.width_mm / OUTLINE * support_mm / 1000
        half_m = tuber.length_mm / 2000
        first = math.floor((tuber.place_x_m - half_m) / STRETCH_M)
        self._cover(first, math.floor((tuber.place_x_m + half_m) / STRETCH_M))

    def take(self, other: Self) -> None:
        """Add what `other` summed up."""
        self.count += other.count
        self.weight_g += other.weight_g
        self.under_ml += other.under_ml
        for first, last in other.runs:
            self._cover(first, last)

    def belt_m(self) -> float:
        """Belt on which tubers lie on others."""
        return STRETCH_M * sum(last - first + 1 for first, last in self.runs)

    def plain(self) -> dict[str, Any]:
        """As JSON keeps it."""
        return {
            "count": self.count,
            "weight_g": self.weight_g,
            "under_ml": self.under_ml,
            "runs": [list(run) for run in self.runs],
        }

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> Self:
        """Back from `plain`."""
        return cls(**{**plain, "runs": [(first, last) for first, last in plain["runs"]]})

    def _cover(self, first: int, last: int) -> None:
        apart = [run for run in self.runs if run[1] < first - 1 or run[0] > last + 1]
        joined = [run for run in self.runs if run not in apart]
        first, last = min([first, *(run[0] for run in joined)]), max([last, *(run[1] for run in joined)])
        self.runs = sorted([*apart, (first, last)])
        if len(self.runs) > RUNS:
            gaps = [b[0] - a[1] for a, b in zip(self.runs, self.runs[1:], strict=False)]
            at = gaps.index(min(gaps))
            self.runs[at : at + 2] = [(self.runs[at][0], self.runs[at + 1][1])]


@dataclass(frozen=True, slots=True)
class Hidden:
    """What lies under others in a load, as estimated.

    Attributes:
        tubers, weight_g: not counted, and not weighed.
        weight_sd_g: how well `weight_g` is known; support_sd_g: the weight of those that lie on them.
        belt_m: belt with more than one layer.
    """

    tubers: float = 0.0
    weight_g: float = 0.0
    weight_sd_g: float = 0.0
    support_sd_g: float = 0.0
    belt_m: float = 0.0


def hidden(layers: LayerSums, *, count: int, scale: float = 1.0) -> Hidden:
    """What the load hides. A belt in one layer hides nothing, and a few odd tubers make no layer.

    Args:
        count: all tubers of the load.
        scale: calibrated over as-weighed grams.
    """
    if layers.count < max(LEAST_TUBERS, LEAST_SHARE * count):
        return Hidden()
    weight_g = HIDDEN_G_PER_ML * layers.under_ml * scale
    return Hidden(
        tubers=HIDDEN_TUBERS_PER_ML * layers.under_ml,
        weight_g=weight_g,
        weight_sd_g=HIDDEN_SD * weight_g,
        support_sd_g=SUPPORT_SD * layers.weight_g * scale,
        belt_m=layers.belt_m(),
    )
