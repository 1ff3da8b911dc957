"""The simulated day's run: its logs through the aggregator's core into a ledger, and the orders of its loads.

What an aggregator's process does between its sockets: entries are received by the clock of the day, committed and
written; a light barrier's orders start and end each box at a place of the belt; tickets are entered in the evening.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import tomli_w

from aggregator.core.load_orders import answer, decide
from aggregator.core.machine import Aggregation
from aggregator.ledger.at_rest import order_at_rest
from aggregator.ledger.writer import Ledger
from aggregator.orders import order_place_x_m
from aggregator.report import Reporter
from benchmarks.day_belts import RUN, Belt, line_config, read_belt
from benchmarks.day_stitch import LOOK_S, Reel, laid, standing
from benchmarks.day_world import CAMERAS, SCALE_ERROR, DayPlan, LoadPlan
from conveyor import __version__
from conveyor.counters import CounterSet
from conveyor.errors import TuberlineError
from conveyor.formats.positions import PositionsWriter
from conveyor.messages import TrackEntry
from conveyor.messages.loads import LoadOrder

LATE_S = 0.2
"""After its frame an entry is at the aggregator."""
EDGE_M = 0.03
"""A light barrier ahead of the cameras tells where a box's tubers begin and end on the belt, with so much to spare."""
CONTRACT = """name = "table potatoes"
measure = "mesh"

[[classes]]
name = "small"
to_mm = 35
at_most_percent = 5

[[classes]]
name = "salad"
from_mm = 35
to_mm = 45

[[classes]]
name = "ware"
from_mm = 45
to_mm = 60
at_least_percent = 40

[[classes]]
name = "large"
from_mm = 60
"""


class DayLine:
    """The aggregator of the day: its core, its ledger and its clock."""

    def __init__(self, ledger: Ledger, core: Aggregation) -> None:
        self.ledger = ledger
        self.core = core

        self.now_s = 0.0

    def receive(self, entries: Iterable[tuple[int, TrackEntry]]) -> None:
        """Receive entries as they come."""
        for when_ns, entry in entries:
            self.now_s = when_ns / 1e9 + LATE_S
            self.core.receive(entry, now_s=self.now_s)

    def commit(self) -> None:
        """Write what has become certain."""
        self.ledger.write(RUN, self.core.commit(now_s=self.now_s))

    def order(self, order: LoadOrder, at_ns: int) -> str:
        """Carry out an order as `aggregator.orders` does; returns what is answered."""
        now_s = at_ns / 1e9
        event = decide(
            order,
            self.ledger.loads,
            run=RUN,
            now_ns=at_ns,
            line={"utc_offset_s": 0, "stated_offset_mm": 0.0},
            place_x_m=lambda asked: order_place_x_m(asked, self.ledger, self.core, now_s),
        )
        self.ledger.say(event)
        self.core.cameras.loads_change()
        return answer(order, event, self.ledger.loads).text


def write_day(plan: DayPlan, belts: Path, out: Path) -> None:
    """Write ledger, summary, tubers.csv, positions and config of the day's run into `out`, which must hold none."""
    out.mkdir(parents=True, exist_ok=True)
    (out / "contract.toml").write_text(CONTRACT, encoding="utf-8")
    config = line_config(out, contract=str((out / "contract.toml").resolve()))
    (out / "line.toml").write_text(tomli_w.dumps(_stated(config.model_dump(mode="json", exclude_defaults=True))))
    _write_positions(plan, out)
    start_ns = int(plan.loads[0].crossed_ns[0]) - 60 * 10**9
    with Ledger(out / "ledger.db") as ledger:
        restored = ledger.open_run(RUN, line=config.name, cameras=CAMERAS, version=__version__, started_ns=start_ns)
        core = Aggregation(
            RUN,
            cameras=CAMERAS,
            merge_gate_mm=config.aggregator.merge_gate_mm,
            camera_stall_s=config.aggregator.camera_stall_s,
            committed=ledger.committed(RUN),
            now_s=start_ns / 1e9,
            restored=restored,
        )
        line = DayLine(ledger, core)
        _drive(plan, belts, line)
        end_s = int(plan.loads[-1].crossed_ns[-1]) / 1e9 + 60
        if not core.finished:
            raise TuberlineError(f"{core.pending} tracks of the day are still pending after its last mark")
        reporter = Reporter(ledger, core, config=config, counters=CounterSet())
        ledger.finish(RUN, reporter.summary_text(end_s), sights=core.cameras.sights)
        reporter.write(out, end_s)


def _drive(plan: DayPlan, belts: Path, line: DayLine) -> None:
    reel = Reel()
    for n, load in enumerate(plan.loads):
        belt: Belt = read_belt(belts, load, plan.seed)
        first_ns, last_ns = int(load.crossed_ns[0]), int(load.crossed_ns[-1])
        places = [row["place_x_m"] - reel.travel_m for row in belt.truth["tubers"]]
        if n:
            line.receive(standing(reel, first_ns - round(LOOK_S * 1e9)))
        begin, end = max(places) + EDGE_M, min(places) - EDGE_M
        start = LoadOrder(
            f"start-{n}",
            "start",
            by="barrier",
            fields={"name": load.name, "field": load.field, "variety": load.stock.cultivar, "operator": "simulated"},
            place_x_m=begin,
        )
        line.order(start, first_ns - 10**9)
        last = n == len(plan.loads) - 1
        line.receive(laid(belt, load, reel, last=last))
        line.order(LoadOrder(f"end-{n}", "end", by="barrier", place_x_m=end), last_ns)
        line.commit()
        if not last:
            line.receive(standing(reel, last_ns + round(LOOK_S * 1e9)))


def enter_ticket(out: Path, load: LoadPlan, true_kg: float, *, seed: int) -> float:
    """Enter what a scale with an error of 0.5 % says of a box, in the ledger at rest; returns it."""
    rng = np.random.default_rng([seed, 2, load.number])
    kg = round(true_kg * (1 + SCALE_ERROR * float(rng.standard_normal())), 2)
    order = LoadOrder(f"ticket-{load.number}", "ticket", by="office", load=str(load.number), kg=kg)
    told = order_at_rest(out / "ledger.db", order)
    if not told.done:
        raise TuberlineError(f"ticket of {load.name}: {told.error}")
    return kg


def _stated(config: dict[str, object]) -> dict[str, object]:
    return {name: value for name, value in config.items() if value is not None}


def _write_positions(plan: DayPlan, out: Path) -> None:
    with PositionsWriter(out / "positions.csv") as file:
        for at_s, lat, lon, quality in plan.positions.tolist():
            at_ns = round(at_s) * 10**9
            file.write((at_ns, at_ns, lat, lon, int(quality), 0.7, 14))
