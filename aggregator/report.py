"""Totals, summary and table of a run, kept up to date as tubers are committed."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from aggregator.calibration.apply import MOST_TOLD_PERCENT
from aggregator.calibration.correction import prior_told
from aggregator.calibration.tickets import Ticket, read_tickets
from aggregator.calibration.together import together
from aggregator.core.class_totals import class_totals, classes_together
from aggregator.core.coverage import Coverage, Moment, at_rest, coverage
from aggregator.core.device import Device
from aggregator.core.foreign_totals import foreign_total
from aggregator.core.height_sums import HeightSums
from aggregator.core.load_state import load_state
from aggregator.core.load_told import load_now
from aggregator.core.loads import Load, LoadEvent
from aggregator.core.machine import Aggregation
from aggregator.core.reasons import LoadState
from aggregator.core.sight import CameraSight
from aggregator.core.totals import LoadTotals
from aggregator.ledger.apart import cameras_apart
from aggregator.ledger.audit import audit_sums
from aggregator.ledger.earlier_loads import heights_before
from aggregator.ledger.exchanged import cameras_exchanged, devices_before
from aggregator.ledger.files import tubers_csv, write_whole
from aggregator.ledger.line_tickets import with_own
from aggregator.ledger.load_totals import Seen, count_load, tickets_of
from aggregator.ledger.reader import read_marks, read_runs
from aggregator.ledger.stated import told_belt
from aggregator.ledger.ticket_doubts import ticket_remark
from aggregator.ledger.totals_by import loads_in
from aggregator.ledger.writer import Ledger
from aggregator.summary import summarise
from conveyor import __version__
from conveyor.apart import apart_in_words
from conveyor.config import LineConfig
from conveyor.contract import read_contract
from conveyor.counters import CounterSet
from conveyor.errors import LedgerError
from conveyor.exchanged import exchanged_in_words
from conveyor.heights import heights_in_words
from conveyor.layers import layers_in_words
from conveyor.messages import CameraExchanged, CamerasApart, LoadNow, Totals, Tuber
from conveyor.messages.base import plain

TABLE_IN_HASTE = 5_000
"""Rows of tubers.csv that are written within the time a process has to stop."""

ROWS_A_TURN = 1000
LOOK_AT_TICKETS_EVERY_S = 5.0
"""What a load with a ticket came to changes while its last tubers come."""
APART_EVERY, APART_EVERY_S = 50, 5.0
"""Tubers and seconds after which it is looked at again whether the cameras agree on places: 20 ms."""


class Reporter:
    """What is told about a run, from the sums that its ledger carries along and from what the cameras looked at."""

    def __init__(self, ledger: Ledger, core: Aggregation, *, config: LineConfig, counters: CounterSet) -> None:
        self._ledger = ledger
        self._core = core
        self._config = config
        self._counters = counters
        settings = config.aggregator
        self._given = read_tickets(settings.tickets) if settings.tickets else ()
        self._by_loads: tuple[tuple[int, int], tuple[Ticket, ...]] = ((0, 0), ())
        self._earlier: dict[int, tuple[tuple[int, int], list[HeightSums]]] = {}
        self._contract = read_contract(settings.contract) if settings.contract else None
        self._apart: tuple[int, float, tuple[CamerasApart, ...]] = (-APART_EVERY, -math.inf, ())
        self._seen_before: dict[str, Seen] = {}
        self._devices_before: dict[str, list[Device]] | None = None
        self._over = False
        self.sheets: Mapping[str, Mapping[str, int]] = {}
        """Newest balance sheets of frames, by camera, as the segmenters report them beside their logs."""
        self.other_versions: dict[str, str] = {}
        """Nodes whose version is not this process's, 'role/name', with theirs."""

    def stopped(self) -> None:
        """The process was told to stop: what is not in the ledger by now was not seen."""
        self._over = True

    def at_rest(self, now_s: float) -> dict[str, CameraSight]:
        """What each camera looked at, as a ledger keeps it whose line is stopped now."""
        return at_rest(self._core.cameras.sights, self._moment(now_s))

    def coverage(self, now_s: float) -> Coverage:
        """What of the load's belt was seen."""
        seen_by = self._ledger.sums(self._core.run).load.seen_by
        return coverage(self._core.cameras.sights, seen_by=seen_by, moment=self._moment(now_s))

    def _moment(self, now_s: float) -> Moment:
        """Now; once the process was told to stop, belt whose tubers are not in the ledger was not seen."""
        cameras = self._core.cameras
        waiting_m = self._core.waiting_m() if self._over else None
        return cameras.moment(now_s, over=self._over or cameras.final, waiting_m=waiting_m)

    def _tickets(self, now_s: float) -> tuple[Ticket, ...]:
        """The tickets given, and those of the ledger's loads: a load's own takes the place of one given before."""
        known = (self._ledger.loads.last_n, int(now_s // LOOK_AT_TICKETS_EVERY_S))
        if not known[0]:
            return self._given
        if self._by_loads[0] != known:
            found, _ = tickets_of(self._ledger, self._seen(now_s), cultivar=self._config.aggregator.cultivar)
            self._by_loads = known, tuple(with_own(self._given, found))
        return self._by_loads[1]

    def _seen(self, now_s: float) -> dict[str, Seen]:
        """What cameras looked at, by run: of this run as it goes on, of others as they ended."""
        cameras, own = self._core.cameras, self._core.run
        runs = dict.fromkeys(run for load in self._ledger.loads.loads.values() for run, _ in load.spans)
        for run in runs:
            if run != own and run not in self._seen_before and (row := self._ledger.run_row(run)) is not None:
                self._seen_before[run] = Seen.at_rest(row, self._ledger.sums(run))
        return {**self._seen_before, own: Seen(cameras.sights, self._moment(now_s))}

    def ticket_remark(self, event: LoadEvent, now_s: float) -> str:
        """What is to be said of a ticket that was entered, in words; '' where nothing is."""
        seen, cultivar = self._seen(now_s), self._config.aggregator.cultivar
        return ticket_remark(self._ledger, event, seen, lambda: self._tickets(now_s), cultivar=cultivar)

    def open_load(self, now_s: float) -> LoadNow | None:
        """The load that is open, by its own sums; None where none is."""
        load = self._ledger.loads.open_load(self._core.run)
        return None if load is None else self._told(load, now_s)

    def _heights_before(self, load: Load, now_s: float) -> list[HeightSums]:
        """Of earlier loads, which change while their last tubers come."""
        known = (self._ledger.loads.last_n, int(now_s // LOOK_AT_TICKETS_EVERY_S))
        if load.number not in self._earlier or self._earlier[load.number][0] != known:
            found = heights_before(self._ledger, load, cultivar=self._config.aggregator.cultivar)
            self._earlier = {load.number: (known, found)}
        return self._earlier[load.number][1]

    def _told(self, load: Load, now_s: float) -> LoadNow:
        return load_now(
            load,
            count_load(self._ledger, load, self._seen(now_s)),
            self._tickets(now_s),
            prior=prior_told(told_belt(self._config)),
            cultivar=self._config.aggregator.cultivar,
            contract=self._contract,
            densities=self._config.foreign,
            earlier=self._heights_before(load, now_s),
        )

    def _cameras_apart(self, count: int, now_s: float) -> tuple[CamerasApart, ...]:
        """How far cameras disagree on places, by the newest of `count` tubers; at the end by the last of them."""
        looked_at, looked_s, found = self._apart
        cameras, ended = self._core.cameras.names, self._over or self._core.finished
        due = count > looked_at if ended else count - looked_at >= APART_EVERY and now_s - looked_s >= APART_EVERY_S
        if len(cameras) > 1 and due:
            gate_mm = self._config.aggregator.merge_gate_mm
            found = cameras_apart(self._ledger.view, self._core.run, cameras, gate_mm=gate_mm)
            self._apart = count, now_s, found
        return found

    def _exchanged(self, now_s: float) -> tuple[CameraExchanged, ...]:
        """Cameras that are not those that were calibrated."""
        view = self._ledger.view
        if self._devices_before is None:
            self._devices_before = devices_before(view, self._core.run)
        return cameras_exchanged(
            self._core.cameras.sights,
            self._devices_before,
            lambda: self._tickets(now_s),
            loads=self._ledger.loads.loads,
            runs=lambda: read_runs(view),
        )

    def totals(self, now_s: float) -> Totals:
        """The totals as they are now."""
        cameras, seen, sums = self._core.cameras, self.coverage(now_s), self._ledger.sums(self._core.run)
        state, reason = load_state(
            cameras.sights,
            seen,
            count=sums.load.count,
            over=self._over or self._core.finished,
            given_up=cameras.given_up(now_s),
            sheets=self.sheets,
        )
        prior, cultivar = prior_told(told_belt(self._config)), self._config.aggregator.cultivar
        totals = LoadTotals(sums.load, self._tickets(now_s), prior=prior, cultivar=cultivar)
        contract = self._contract
        told = totals.message(
            self._core.run,
            coverage=seen.share,
            cameras=cameras.says(now_s),
            final=self._core.finished,
            state=state,
            reason=reason,
            belt_m=seen.belt_m,
            most_m=seen.most_m,
            unseen_m=seen.mean_unseen_m(),
            load=self.open_load(now_s),
            contract=contract.told if contract else "",
            classes=class_totals(totals, contract) if contract else (),
            foreign=foreign_total(totals, self._config.foreign),
            apart=self._cameras_apart(sums.load.count, now_s),
            exchanged=self._exchanged(now_s),
            now_ns=max((sight.last_ns for sight in cameras.sights.values()), default=None),
        )
        return self._load_by_load(told, totals, now_s) if self._core.run in self._ledger.loads.spans else told

    def _load_by_load(self, told: Totals, totals: LoadTotals, now_s: float) -> Totals:
        """The totals of a run in which loads were started: the sum of them, each by its variety and its own belt."""
        prior, cultivar = prior_told(told_belt(self._config)), self._config.aggregator.cultivar
        ones = loads_in(
            self._ledger,
            self._core.run,
            self._seen(now_s),
            self._tickets(now_s),
            prior_of=lambda _run: prior,
            cultivar=cultivar,
        )
        sums, loads = together(ones), [one.totals for one in ones]
        by = dict.fromkeys(filter(None, (load.calibrated().told for load in loads)))
        return replace(
            told,
            weight_g=sums.weight_g,
            low_g=sums.seen_g[0],
            high_g=sums.seen_g[1],
            estimated_weight_g=sums.estimated_g,
            estimated_low_g=sums.low_g,
            estimated_high_g=sums.high_g,
            tickets=sums.tickets,
            calibrated_by="; ".join(by),
            parts_percent={name: round(min(part, MOST_TOLD_PERCENT), 2) for name, part in sums.parts_percent.items()},
            classes=classes_together(loads, self._contract, whole=[one.whole for one in ones])
            if self._contract
            else (),
            foreign=foreign_total(totals, self._config.foreign, weight_g=sums.weight_g),
        )

    def summary(self, now_s: float) -> dict[str, Any]:
        """The summary as plain values, from the ledger's sums and this process's counters."""
        run = self._ledger.run_row(self._core.run)
        if run is None:
            raise LedgerError(f"run '{self._core.run}' is not in ledger {self._ledger.path}")
        sums = self._ledger.sums(run.run)
        told = summarise(
            self.totals(now_s),
            line=self._config.name,
            version=__version__,
            other_versions=dict(sorted(self.other_versions.items())),
            audit=audit_sums(run, sums, read_marks(self._ledger.view, run)),
            coverage=self.coverage(now_s),
            counters=self._counters.snapshot()[0],
            models=sums.load.models(),
            methods=sums.load.methods(),
            tubers={"committed": sums.load.count, "merged": sums.load.merged, "late": sums.load.late},
            belt=told_belt(self._config),
        )
        return told | ({"loads": loads} if (loads := self._loads(now_s)) else {})

    def _loads(self, now_s: float) -> list[dict[str, Any]]:
        """The loads that have belt in this run, as `conveyor.messages.LoadNow` has them; oldest first."""
        own = [load for load in self._ledger.loads.loads.values() if self._core.run in (run for run, _ in load.spans)]
        return [plain(self._told(load, now_s)) for load in own]

    def summary_text(self, now_s: float) -> str:
        """The summary as JSON."""
        return json.dumps(self.summary(now_s), indent=2) + "\n"

    def write(
        self, folder: Path, now_s: float, *, in_haste: bool = False, turn: Callable[[], None] = lambda: None
    ) -> bool:
        """Write tubers.csv and summary.json into `folder`; the summary last, so that it never stands alone.

        `in_haste`: a process that was told to stop leaves a long table out. `turn` is called every thousand rows.
        Returns whether the table was written.
        """
        run = self._core.run
        table = not in_haste or self._ledger.sums(run).load.count <= TABLE_IN_HASTE
        if table:
            write_whole(
                folder / "tubers.csv",
                tubers_csv(_in_turns(self._ledger.tubers(run), turn), self._ledger.loads.spans.get(run, ())),
            )
        write_whole(folder / "summary.json", self.summary_text(now_s))
        return table

    def headline(self, now_s: float) -> str:
        """One line for the log."""
        totals = self.totals(now_s)
        if totals.state == LoadState.NOTHING_SEEN:
            return f"nothing seen: {totals.reason}; final={totals.final}"
        layers = layers_in_words(totals.hidden, totals.layered_m, totals.belt_m)
        heights = heights_in_words(totals.load.heights) if totals.load else ""
        apart, exchanged = apart_in_words(totals.apart), exchanged_in_words(totals.exchanged)
        seen = "unknown" if totals.coverage is None else f"{100 * totals.coverage:.1f} %"
        return (
            f"{totals.count} tubers, {totals.weight_g / 1000:.3f} kg "
            f"({totals.low_g / 1000:.3f} to {totals.high_g / 1000:.3f}), belt seen {seen}, "
            f"calibrated by {totals.calibrated_by or 'nothing'}, final={totals.final}"
            f"{layers and '; ' + layers}{heights and '; ' + heights}{apart and '; ' + apart}"
            f"{exchanged and '; ' + exchanged}"
        )


def _in_turns(tubers: Iterable[Tuber], turn: Callable[[], None]) -> Iterator[Tuber]:
    for n, tuber in enumerate(tubers):
        if n % ROWS_A_TURN == 0:
            turn()
        yield tuber
