"""Loads that a load's heights may be compared with: earlier ones of its kind in the same ledger."""

from __future__ import annotations

from aggregator.core.height_change import MOST_LOADS
from aggregator.core.height_sums import HeightSums
from aggregator.core.load_sums import LoadSums
from aggregator.core.loads import SAME_OFFSET_MM, Load
from aggregator.ledger.load_totals import Sums
from conveyor.typed_names import name_key


def heights_before(ledger: Sums, load: Load, *, cultivar: str = "") -> list[HeightSums]:
    """Of the newest loads before `load` with its variety, weights and stated resting offset; the newest last.

    Heights are over the resting level as the line states it, so loads with another one are no measure. A variety that
    is not named is one of its own. `cultivar`: where a load names none.
    """
    mine = _sums(ledger, load)
    found: list[HeightSums] = []
    for other in sorted(ledger.loads.loads.values(), key=lambda one: one.number, reverse=True):
        if len(found) == MOST_LOADS:
            break
        if other.number >= load.number or other.undone or not other.spans:
            continue
        if name_key(other.variety or cultivar) != name_key(load.variety or cultivar):
            continue
        if abs(other.stated_offset_mm - load.stated_offset_mm) > SAME_OFFSET_MM:
            continue
        sums = _sums(ledger, other)
        if sums.heights is not None and _main_model(sums) == _main_model(mine):
            found.append(sums.heights)
    return found[::-1]


def _sums(ledger: Sums, load: Load) -> LoadSums:
    """Of all stretches of belt of a load, in all runs."""
    whole = LoadSums(50.0)
    for run, span in load.spans:
        if (own := ledger.span_sums(run).get(span)) is not None:
            whole.take(own.load)
    return whole


def _main_model(sums: LoadSums) -> str:
    """The weights that weighed most of it."""
    models = sums.models()
    return max(sorted(models), key=lambda name: models[name], default="")
