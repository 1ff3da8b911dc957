"""The loads of a ledger, each with what it came to: from the sums carried along, whatever their size is."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Protocol

from aggregator.calibration.correction import Prior, prior_told
from aggregator.calibration.load_tickets import load_ticket
from aggregator.calibration.tickets import Ticket
from aggregator.core.coverage import Coverage, Moment
from aggregator.core.load_orders import find
from aggregator.core.load_sums import LoadSums
from aggregator.core.load_told import LoadCounted, counted, span_coverage
from aggregator.core.loads import NO_LOAD, Load, LoadBook, span_of
from aggregator.core.sight import CameraSight
from aggregator.ledger.ends import end_of, less_than_all
from aggregator.ledger.load_rows import SpanSums, read_book, read_span_sums
from aggregator.ledger.reader import (
    RunRow,
    coverage_of,
    ledger_file,
    moment_of,
    read_runs,
    read_sums,
    read_tubers,
    reading,
    run_being_written,
    sights_of,
)
from aggregator.ledger.stated import Stated, belt_of_run, stated_beside, summary_told
from aggregator.ledger.sums import RunSums
from aggregator.ledger.verified import LedgerView
from conveyor.errors import InputError
from conveyor.messages import Tuber


class Sums(Protocol):
    """Where sums come from: a ledger that is being written, or one that is read."""

    @property
    def loads(self) -> LoadBook:
        """All that was said of loads."""
        ...

    def span_sums(self, run: str) -> Mapping[int, SpanSums]:
        """The sums of each stretch of a run."""
        ...


@dataclass(frozen=True, slots=True)
class Seen:
    """What the cameras of a run looked at, and when that is asked for."""

    sights: Mapping[str, CameraSight]
    moment: Moment

    @classmethod
    def at_rest(cls, run: RunRow, sums: RunSums) -> Seen:
        """Of a run that is over."""
        return cls(sights_of(run, sums), Moment(over=True))


def parts_of(ledger: Sums, run: str, load: int, seen: Seen) -> list[tuple[LoadSums, Coverage]]:
    """Sums and coverage of each stretch of `run` that belongs to `load`, `NO_LOAD` included."""
    spans, sums = ledger.loads.spans.get(run, []), ledger.span_sums(run)
    found = []
    for at, span in enumerate(spans):
        if span.load == load:
            mine = sums[span.n]
            told = mine.seen or span_coverage(spans, at, mine.load, seen.sights, seen.moment)
            found.append((mine.load, told))
    return found


def count_load(ledger: Sums, load: Load, seen: Mapping[str, Seen]) -> LoadCounted:
    """What a load came to, over all runs in which it has belt; `seen` by run."""
    runs = dict.fromkeys(run for run, _ in load.spans)
    parts = [part for run in runs for part in parts_of(ledger, run, load.number, seen[run])]
    found = counted(parts or [(LoadSums(50.0), Coverage(None, 0.0, {}, {}))])
    return replace(found, stated_offset_mm=_stated_mm(ledger, load), open=is_open(ledger, load, seen))


def is_open(ledger: Sums, load: Load, seen: Mapping[str, Seen]) -> bool:
    """Whether a line that runs counts to `load` now. Where its run ended or was stopped, it ended there."""
    return any(ledger.loads.open_load(run) is load and not seen[run].moment.over for run, _ in load.spans)


def _stated_mm(ledger: Sums, load: Load) -> float:
    """The resting offset that a load was weighed with: of its stretches in the mean, each by what a millimetre is worth
    there.
    """
    resumed_mm, worth_g, sum_g_mm = dict(load.resumed_at_mm), 0.0, 0.0
    for run, n in load.spans:
        if (own := ledger.span_sums(run).get(n)) is not None:
            worth_g += own.load.per_mm_g
            sum_g_mm += own.load.per_mm_g * resumed_mm.get(n, load.stated_offset_mm)
    return sum_g_mm / worth_g if worth_g > 0 else load.stated_offset_mm


def tickets_of(ledger: Sums, seen: Mapping[str, Seen], *, cultivar: str = "") -> tuple[list[Ticket], dict[int, str]]:
    """(the tickets of a ledger's loads that can calibrate; why the others cannot, in words by the load's number).

    `cultivar`: of loads that name no variety.
    """
    tickets, refused = [], {}
    for load in ledger.loads.loads.values():
        if load.ticket(net=True) is None:
            continue
        try:
            ticket = load_ticket(load, count_load(ledger, load, seen), cultivar=cultivar)
        except InputError as error:
            refused[load.number] = str(error)
        else:
            tickets += [ticket] if ticket is not None else []
    return tickets, refused


def ticket_of_load(path: Path, wanted: str, *, cultivar: str = "") -> Ticket:
    """The ticket of a load in the ledger (or a run's folder) at `path`, by number or name.

    Raises:
        LedgerError: no ledger, or one that cannot be read. InputError: no such load, none entered, or one that cannot
            calibrate; the text says why.
    """
    with reading(ledger_file(path)) as view:
        ledger = ReadLoads(view)
        load = find(ledger.loads, wanted, run="")
        ticket = load_ticket(load, count_load(ledger, load, ledger.seen), cultivar=cultivar)
    if ticket is None:
        raise InputError(f"{load.told} has no net ticket: tuberline load ticket {load.number} --kg ... --ledger {path}")
    return ticket


def without_load(ledger: Sums, run: str, seen: Seen) -> LoadCounted | None:
    """What passed in `run` while no load was open; None where a load was open all the time."""
    parts = [(own, told) for own, told in parts_of(ledger, run, NO_LOAD, seen) if own.count or told.belt_m > 0]
    return counted(parts) if parts else None


def here(load: Load, run: str) -> Load:
    """Of a load that went on elsewhere its belt in `run` alone."""
    return replace(load, spans=tuple(span for span in load.spans if span[0] == run))


class ReadLoads:
    """The loads of a ledger that is read, as `Sums`."""

    def __init__(self, view: LedgerView) -> None:
        self._view = view
        self.path = view.path
        self.loads = read_book(view)
        self.runs = {run.run: run for run in read_runs(view)}
        self._sums: dict[str, RunSums] = {}
        self._span_sums: dict[str, dict[int, SpanSums]] = {}
        self._less: dict[str, str] = {}
        self._priors: dict[str, Prior] = {}

    @cached_property
    def stated(self) -> Stated:
        """By the config beside the ledger."""
        return stated_beside(self._view.path)

    def prior(self, run: str) -> Prior:
        """What the line stated of its resting level in `run`; as wide as before any calibration where it did not."""
        if run not in self._priors:
            self._priors[run] = prior_told(belt_of_run(self._view, run, self.sums(run), self.stated) or {})
        return self._priors[run]

    def first_tuber(self, run: str) -> Tuber | None:
        """The first one of a run; None where there is none."""
        return next(read_tubers(self._view, run, limit=1), None)

    def sums(self, run: str) -> RunSums:
        """The sums of a run."""
        if run not in self._sums:
            self._sums[run] = read_sums(self._view, run)
        return self._sums[run]

    def utc_offset_s(self, run: str) -> int | None:
        """Of the line's clock when a run began; where its sums do not state it, as a load of it or of the ledger does.
        None where none does.
        """
        stated = self.sums(run).utc_offset_s
        loads = sorted(self.loads.loads.values(), key=lambda load: load.run != run)
        return stated if stated is not None else next((load.utc_offset_s for load in loads), None)

    def span_sums(self, run: str) -> Mapping[int, SpanSums]:
        """The sums of each stretch of a run."""
        if run not in self._span_sums:
            self._span_sums[run] = read_span_sums(self._view, run)
        return self._span_sums[run]

    @cached_property
    def _written(self) -> str | None:
        return run_being_written(self._view)

    @cached_property
    def seen(self) -> dict[str, Seen]:
        """What the cameras of each run looked at: it is over, but for the one that a line is writing."""
        return {
            name: Seen(sights_of(run, self.sums(name)), moment_of(run, self._written))
            for name, run in self.runs.items()
        }

    def remarks(self, runs: Iterable[str]) -> tuple[str, ...]:
        """In sentences, which of `runs` were cut off or repaired with losses, in the order in which they began."""
        wanted = set(runs)
        return tuple(words for name in self.runs if name in wanted and (words := self._less_than_all(name)))

    def _less_than_all(self, name: str) -> str:
        if name not in self._less:
            sums = self.sums(name)
            end = end_of(self.runs[name], self._written, sums=sums, summary=summary_told(self._view, name, sums))
            self._less[name] = less_than_all(name, end, lacks=sums.lacks)
        return self._less[name]

    def load_of(self, tuber: Tuber) -> int:
        """Number of the load that a tuber belongs to, or `NO_LOAD`."""
        spans = self.loads.spans.get(tuber.run)
        return span_of(spans, tuber.place_x_m).load if spans else NO_LOAD

    def whole(self, run: RunRow) -> LoadCounted:
        """A run in which no load was started: it is one load by itself."""
        sums = self.sums(run.run)
        return counted([(sums.load, coverage_of(run, sums, self.seen[run.run].moment))])
