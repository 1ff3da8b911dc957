"""What the aggregator and every node report."""

from __future__ import annotations

from dataclasses import dataclass, field

from conveyor.messages.base import Message


@dataclass(frozen=True, slots=True)
class Tuber(Message):
    """One counted tuber, as committed.

    `place_x_m`, `place_y_m` are its place on the belt (x - travel, y). `low_g`, `high_g` bound the 90 % interval of
    its fused weight. `cameras` saw it, `tracks` are their track ids. `method` is 'pointraft', or 'volume' where no
    view could be weighed.
    """

    tuber_id: int
    run: str
    crossed_ns: int
    place_x_m: float
    place_y_m: float
    weight_g: float
    low_g: float
    high_g: float
    length_mm: float
    width_mm: float
    height_mm: float
    views: int
    method: str
    model: str
    flags: tuple[str, ...]
    cameras: tuple[str, ...]
    tracks: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Totals(Message):
    """What the load weighs so far: as seen, and as estimated for the belt that was not looked at.

    `coverage` is the share of belt travel really looked at (None before the belt moved). `histogram` counts tubers per
    weight class of `histogram_step_g` grams, the first from 0 g. `final`: all cameras ended. `as_weighed_g` is the sum
    of the tubers; `weight_g` differs from it where `tickets` calibrate the load, and `calibrated_by` says which, and
    how. `parts_percent` are the 90 % half-widths of the estimate by cause, in percent of it; their squares add up.
    """

    run: str
    count: int
    weight_g: float
    low_g: float
    high_g: float
    coverage: float | None
    estimated_weight_g: float
    estimated_low_g: float
    estimated_high_g: float
    tubers_per_s: float
    histogram_step_g: float
    histogram: tuple[int, ...]
    cameras: dict[str, str]
    final: bool
    as_weighed_g: float = 0.0
    tickets: int = 0
    calibrated_by: str = ""
    parts_percent: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Counters(Message):
    """What a node received, did and dropped. `values` only grow while it lives; `gauges` are levels, among them the
    balance sheet of the run it works on, which starts anew with another run."""

    role: str
    name: str
    run: str
    pid: int
    host: str
    version: str
    uptime_s: float
    values: dict[str, int]
    gauges: dict[str, float]
    status: str = "ok"

    def count(self, name: str) -> int:
        """The count `name`, wherever it is kept; 0 where it never happened."""
        return self.values.get(name, int(self.gauges.get(name, 0)))
