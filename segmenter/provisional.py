"""What tracks weigh so far, for people who look: one store for the page's picture and for Rerun and Foxglove."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from statistics import median

from conveyor.messages import Weight

REMEMBERED = 1024
"""Tracks; those weighed last are kept."""
MOST_VIEWS = 16
"""Of one track; more than a line weighs of a tuber."""


@dataclass(frozen=True, slots=True)
class Provisional:
    """Grams by the views weighed so far, with their 90 % interval."""

    weight_g: float
    low_g: float
    high_g: float


class ProvisionalWeights:
    """The views weighed so far of each track, and their median: one bad view does not show."""

    def __init__(self) -> None:
        self._views: OrderedDict[str, list[Provisional]] = OrderedDict()

    def add(self, weight: Weight) -> None:
        """Take a regressor's answer; one without a weight changes nothing."""
        if weight.weight_g is None or weight.low_g is None or weight.high_g is None:
            return
        views = self._views.setdefault(weight.track_id, [])
        self._views.move_to_end(weight.track_id)
        views.append(Provisional(weight.weight_g, weight.low_g, weight.high_g))
        del views[:-MOST_VIEWS]
        if len(self._views) > REMEMBERED:
            self._views.popitem(last=False)

    def of(self, track_id: str) -> Provisional | None:
        """What the track weighs as far as is known; None before the first answer."""
        views = self._views.get(track_id)
        if not views:
            return None
        return Provisional(
            weight_g=median(view.weight_g for view in views),
            low_g=median(view.low_g for view in views),
            high_g=median(view.high_g for view in views),
        )
