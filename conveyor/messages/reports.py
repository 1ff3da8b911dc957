"""What the aggregator and every node report."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from conveyor.messages.apart import CamerasApart
from conveyor.messages.base import Message
from conveyor.messages.classes import ClassTotal
from conveyor.messages.exchanged import CameraExchanged
from conveyor.messages.foreign import ForeignTotal
from conveyor.messages.loads import LoadNow
from conveyor.messages.sizes import Sizes
from conveyor.ranges import (
    BeltPlace,
    Count,
    Id,
    Items,
    Line,
    LoadGrams,
    Model,
    Name,
    Nanoseconds,
    Range,
    TuberGrams,
    Word,
    Words,
    Yes,
)


@dataclass(frozen=True, slots=True)
class Tuber(Message):
    """One counted tuber, as committed. What any tracks that may be received come to fits into its ranges.

    `place_x_m`, `place_y_m` are its place on the belt (x - travel, y). `low_g`, `high_g` bound the 90 % interval of
    its fused weight. `cameras` saw it, `tracks` are their track ids. `method` is 'pointraft', or 'volume' where no
    view could be weighed. `length_mm`, `width_mm`, `height_mm` are of its visible outline and its height above the
    resting level; `sizes` are those of the whole tuber, None where no view says them.
    `log_odds`: of tuber against clod, stone or haulm, as the classifier believes; None where it was not asked.
    """

    LATER_FIELDS = "ignore"

    tuber_id: Count
    run: Name
    crossed_ns: Nanoseconds
    place_x_m: Annotated[float, Range(-1e9, 1e9, "m")]
    place_y_m: Annotated[float, Range(-1000, 1000, "m")]
    weight_g: TuberGrams
    low_g: TuberGrams
    high_g: TuberGrams
    length_mm: Annotated[float, Range(0, 2001, "mm")]
    width_mm: Annotated[float, Range(0, 2001, "mm")]
    height_mm: Annotated[float, Range(0, 2001, "mm")]
    views: Count
    method: Word
    model: Model
    flags: Words
    cameras: Annotated[tuple[Name, ...], Items(256)]
    tracks: Annotated[tuple[Id, ...], Items(1024)]
    sizes: Sizes | None = None
    log_odds: Annotated[float, Range(-1000, 1000, "")] | None = None


@dataclass(frozen=True, slots=True)
class Totals(Message):
    """What the run weighs so far: as seen, and as estimated for the belt that was not looked at. Where loads are
    started and ended in it, `load` is the one that is open; None where none is, and then the run is one load.

    `coverage` is the share of belt travel really looked at (None before the belt moved). `histogram` counts tubers per
    weight class of `histogram_step_g` grams, the first from 0 g. `final`: all cameras ended. `as_weighed_g` is the sum
    of the tubers; `weight_g` differs from it where `tickets` calibrate the load, and `calibrated_by` says which, and
    how. `parts_percent` are the 90 % half-widths of the estimate by cause, in percent of it; their squares add up.

    `state` is 'starting' (not counting yet), 'counting', 'nothing seen' (then the weights are no numbers; `reason` says
    why) or 'ended'. `belt_m` is the belt from the load's first metre to its last, as far as known; `unseen_m` what of
    it was not seen, by reason, metres in the mean of the cameras. On `layered_m` of it tubers lie in more than one
    layer: `hidden` of them, `hidden_g` grams, are estimated to lie under others; they are in the estimate alone.

    `classes` are those of the contract, named and measured as `contract` says; none without one.
    `foreign` is what is no tuber: clods, stones, haulm. `apart`: how far cameras disagree on the places of the newest
    tubers that both saw. `exchanged`: cameras that are not those that were calibrated.
    """

    LATER_FIELDS = "ignore"

    run: Name
    count: Count
    weight_g: LoadGrams
    low_g: LoadGrams
    high_g: LoadGrams
    coverage: Annotated[float, Range(0, 1 + 1e-9, "share of the belt")] | None
    estimated_weight_g: LoadGrams
    estimated_low_g: LoadGrams
    estimated_high_g: LoadGrams
    tubers_per_s: Annotated[float, Range(0, 1e18, "1/s")]
    histogram_step_g: Annotated[float, Range(0, 1e6, "g")]
    histogram: Annotated[tuple[Count, ...], Items(4096)]
    cameras: Annotated[dict[Name, Word], Items(256)]
    final: Yes
    as_weighed_g: LoadGrams = 0.0
    tickets: Count = 0
    state: Word = "counting"
    reason: Line = ""
    belt_m: BeltPlace | None = None
    unseen_m: Annotated[dict[Word, BeltPlace], Items(64)] = field(default_factory=dict)
    calibrated_by: Line = ""
    parts_percent: Annotated[dict[Word, Annotated[float, Range(0, 1e6, "%")]], Items(16)] = field(default_factory=dict)
    load: LoadNow | None = None
    hidden: Annotated[float, Range(0, 1e15, "tubers")] = 0.0
    hidden_g: LoadGrams = 0.0
    layered_m: BeltPlace = 0.0
    contract: Line = ""
    classes: Annotated[tuple[ClassTotal, ...], Items(32)] = ()
    foreign: ForeignTotal | None = None
    apart: Annotated[tuple[CamerasApart, ...], Items(256)] = ()
    exchanged: Annotated[tuple[CameraExchanged, ...], Items(256)] = ()

    @property
    def no_number(self) -> bool:
        """Nothing was seen, or nothing is counted yet: then no weight is to be shown, but why."""
        return self.state == "nothing seen" or (self.state == "starting" and not self.count)

    @property
    def belt_unknown(self) -> bool:
        """There is a weight, and it is not known how much of the belt was looked at: `reason` says why."""
        return self.coverage is None and self.state in ("counting", "ended") and bool(self.reason)


@dataclass(frozen=True, slots=True)
class Counters(Message):
    """What a node received, did and dropped. `values` only grow while it lives; `gauges` are levels, among them the
    balance sheet of the run it works on, which starts again with another run. `status` is 'ok' or 'stalled'; the last
    one of a node that leaves says 'ended', or 'failed' where an error made it leave."""

    LATER_FIELDS = "ignore"

    role: Name
    name: Name
    run: Name
    pid: Annotated[int, Range(0, 1 << 32, "")]
    host: Word
    version: Word
    uptime_s: Annotated[float, Range(0, 1e10, "s")]
    values: Annotated[dict[Word, Count], Items(4096)]
    gauges: Annotated[dict[Word, Annotated[float, Range(-1e300, 1e300, "")]], Items(4096)]
    status: Word = "ok"

    def count(self, name: str) -> int:
        """The count `name`, wherever it is kept; 0 where it never happened."""
        return self.values.get(name, int(self.gauges.get(name, 0)))
