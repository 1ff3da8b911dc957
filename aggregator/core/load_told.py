"""What a load comes to: sums and coverage of all its stretches of belt, told with its interval. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from aggregator.calibration.correction import Prior
from aggregator.calibration.tickets import Ticket
from aggregator.core.class_totals import class_totals
from aggregator.core.coverage import Coverage, Moment, belt_window, coverage
from aggregator.core.foreign_totals import foreign_total
from aggregator.core.height_change import height_changes
from aggregator.core.height_sums import HeightSums
from aggregator.core.load_sums import LoadSums
from aggregator.core.loads import Load, Span
from aggregator.core.sight import CameraSight
from aggregator.core.totals import LoadTotals
from conveyor.config_yield import ForeignConfig
from conveyor.contract import Contract
from conveyor.messages import LoadNow


@dataclass(frozen=True, slots=True)
class LoadCounted:
    """A load as counted.

    Attributes:
        sums: over its tubers. coverage: share of its belt that was looked at; None where it has no belt.
        belt_m: of all its stretches. unseen_m: of that not seen, by reason, metres in the mean of the cameras.
        most_m: the belt that can have passed at most, where it is not known how far it moved; else None.
        stated_offset_mm: resting offset that it was weighed with, in the mean where the line's file changed on the way;
            None where no load was started.
        open: its line runs, and what passes now belongs to it.
    """

    sums: LoadSums
    coverage: float | None
    belt_m: float
    unseen_m: Mapping[str, float]
    most_m: float | None = None
    stated_offset_mm: float | None = None
    open: bool = False

    def known_before(self, prior: Prior) -> Prior:
        """`prior` of the run, with the offset that this load was weighed with."""
        return prior if self.stated_offset_mm is None else replace(prior, stated_offset_mm=self.stated_offset_mm)


def span_coverage(
    spans: Sequence[Span], at: int, sums: LoadSums, sights: Mapping[str, CameraSight], moment: Moment
) -> Coverage:
    """What of a stretch of belt was seen; `spans` are all of its run, in order."""
    end_x_m = spans[at + 1].from_x_m if at + 1 < len(spans) else -math.inf
    window = belt_window(sights, spans[at].from_x_m, end_x_m)
    return coverage(sights, seen_by=sums.seen_by, moment=moment, window=window)


def counted(parts: Sequence[tuple[LoadSums, Coverage]]) -> LoadCounted:
    """A load of these stretches; there must be one."""
    sums = LoadSums(parts[0][0].histogram_step_g)
    unseen_m: dict[str, float] = {}
    seen_m = belt_m = 0.0
    for own, seen in parts:
        sums.take(own)
        belt_m += seen.belt_m
        seen_m += (seen.share or 0.0) * seen.belt_m
        for why, metres in seen.mean_unseen_m().items():
            unseen_m[why] = unseen_m.get(why, 0.0) + metres
    if any(seen.most_m is not None for _, seen in parts):  # then nor is it of the whole
        return LoadCounted(sums, None, belt_m, unseen_m, sum(seen.most_m or seen.belt_m for _, seen in parts))
    return LoadCounted(sums, seen_m / belt_m if belt_m > 0 else None, belt_m, unseen_m)


def load_now(
    load: Load,
    found: LoadCounted,
    tickets: Sequence[Ticket],
    *,
    prior: Prior | None = None,
    cultivar: str = "",
    contract: Contract | None = None,
    densities: ForeignConfig | None = None,
    earlier: Sequence[HeightSums] = (),
) -> LoadNow:
    """The open load as the totals tell it; `cultivar` where it names no variety of its own.

    `earlier`: of loads that it may be compared with (`aggregator.ledger.earlier_loads`), the newest last.
    """
    known = found.known_before(prior or Prior())
    totals = LoadTotals(found.sums, tickets, prior=known, cultivar=load.variety or cultivar)
    low_g, high_g = totals.interval_g()
    whole_g, whole_low_g, whole_high_g = totals.estimated(found.coverage, belt_m=found.belt_m, most_m=found.most_m)
    return LoadNow(
        number=load.number,
        name=load.name,
        trailer=load.trailer,
        field=load.field,
        variety=load.variety,
        customer=load.customer,
        operator=load.operator,
        since_unix_s=load.began_ns / 1e9,
        count=found.sums.count,
        weight_g=totals.weight_g,
        low_g=low_g,
        high_g=high_g,
        coverage=found.coverage,
        estimated_weight_g=whole_g,
        estimated_low_g=whole_low_g,
        estimated_high_g=whole_high_g,
        as_weighed_g=found.sums.as_weighed_g,
        belt_m=found.belt_m,
        unseen_m=dict(found.unseen_m),
        calibrated_by=totals.calibrated().told,
        classes=class_totals(totals, contract) if contract else (),
        foreign=foreign_total(totals, densities or ForeignConfig()),
        heights=height_changes(found.sums.heights or HeightSums(), earlier),
    )
