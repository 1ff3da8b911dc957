"""Totals per load, field, variety, day and season, over one or many ledgers."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from aggregator.calibration.correction import Prior
from aggregator.calibration.tickets import Ticket
from aggregator.calibration.together import OneLoad, Together, together
from aggregator.core.load_told import LoadCounted
from aggregator.core.loads import Load
from aggregator.core.totals import LoadTotals
from aggregator.ledger.line_tickets import line_tickets
from aggregator.ledger.load_totals import ReadLoads, Seen, Sums, count_load, here, without_load
from aggregator.ledger.reader import RunRow, ledger_file, reading
from aggregator.ledger.stated import Stated
from aggregator.ledger.ticket_doubts import ledger_doubts, of_other_weights
from conveyor.config import REPLAY_NAME
from conveyor.errors import InputError
from conveyor.typed_names import name_key

BY = ("load", "field", "variety", "day", "season")
TYPED = ("field", "variety")
"""Names that people type: those that differ in capitals and spaces alone are one, called as it was first."""
NOT_TOLD = "(not told)"
ALL = "all"
DAY = "%Y-%m-%d"
DAYS_FROM_NS = 946_684_800_000_000_000
"""The year 2000: times before it are a camera's own, of no day."""


@dataclass(frozen=True, slots=True)
class Total:
    """What the loads under one label come to together (`aggregator.calibration.together.Together`).

    `loads`: how many. `weighed`: how many of them have a net ticket, and `net_g` what those say together; `raw_g` is
    the estimate of all before any calibration. `remarks`: which of their runs were cut off or repaired with losses, in
    sentences. `without_load`: in how many runs some of it passed while no load was open; that is no load, and in all
    else.
    """

    label: str
    loads: int
    weighed: int
    net_g: float
    raw_g: float
    sums: Together
    remarks: tuple[str, ...] = ()
    without_load: int = 0


@dataclass(frozen=True, slots=True)
class Labelled:
    """A load to be added, with the label that it has by each of `BY`.

    `net_g` is what a scale said. `load` is None for a run without loads, and for what passed without one; `run` is the
    one in which that was, or in which the load began. `is_load`: it is more than what passed without one. `remarks`: as
    in `Total`.
    """

    labels: dict[str, str]
    one: OneLoad
    net_g: float | None
    load: Load | None
    unseen_m: Mapping[str, float]
    run: str
    is_load: bool
    remarks: tuple[str, ...]

    @property
    def runs(self) -> set[str]:
        """All runs in which it has belt."""
        return {self.run} if self.load is None else {run for run, _ in self.load.spans}


@dataclass(frozen=True, slots=True)
class AllLoads:
    """The loads of some ledgers.

    Attributes:
        by_ledger: those of each, by its file. refused: tickets that cannot calibrate, in words. doubts: what else is
            to be said of tickets: that others contradict them, that they hold for one ledger alone, or for other
            weights, or that those which a line's config names cannot be read. stated: by the config beside each.
    """

    by_ledger: Mapping[Path, list[Labelled]]
    refused: list[str]
    doubts: list[str]
    stated: Mapping[Path, Stated]

    @property
    def loads(self) -> list[Labelled]:
        """All of them, ledger by ledger."""
        return [load for loads in self.by_ledger.values() for load in loads]

    def of(self, path: Path) -> list[Labelled]:
        """Those of one of the ledgers (or folders of runs)."""
        return self.by_ledger[ledger_file(path).resolve()]


def totals_by(paths: Sequence[Path], by: str, *, tickets: Sequence[Ticket] = ()) -> tuple[list[Total], list[str]]:
    """(totals by label, the sum of all last; tickets that cannot calibrate, in words); as `all_loads` and `sums_by`."""
    found = all_loads(paths, tickets=tickets)
    return sums_by(found.loads, by), found.refused


def sums_by(loads: Sequence[Labelled], by: str) -> list[Total]:
    """Totals by label, the sum of all last; none where there is no load.

    Args:
        by: one of `BY`.

    Raises:
        InputError: it is none of these.
    """
    if by not in BY:
        raise InputError(f"totals by {by!r}: known are {', '.join(BY)}")
    return [*grouped(loads, by), total_of(ALL, loads)] if loads else []


def all_loads(paths: Sequence[Path], *, tickets: Sequence[Ticket] = (), day: str | None = None) -> AllLoads:
    """Every load of these ledgers, each calibrated by the tickets of its line (`aggregator.ledger.line_tickets`).

    A run in which no load was started is one load by itself; what passed while none was open is told as that.

    Args:
        paths: folders of runs, or ledgers.
        tickets: more, which calibrate all of them. Of two of the same load its own is taken, else the one given here.
        day: YYYY-MM-DD; where it is given, what is said of tickets is said of those of its loads alone.

    Raises:
        LedgerError: a ledger that cannot be read, or two that hold the same run.
    """
    with ExitStack() as stack:
        files = dict.fromkeys(ledger_file(path).resolve() for path in paths)
        ledgers = {file: ReadLoads(stack.enter_context(reading(file))) for file in files}
        each = list(zip(ledgers.items(), line_tickets(list(ledgers.values()), tickets), strict=True))
        loads = _told_apart(
            {file: labelled(ledger, known.tickets) for (file, ledger), known in each},
            lines={file: {name: run.line for name, run in ledger.runs.items()} for file, ledger in ledgers.items()},
        )
        of_day = [load for found in loads.values() for load in found if load.labels["day"] == day]

        def asked(ticket: Ticket) -> bool:
            return day is None or _is_of(ticket, of_day)

        refused, doubts = list[str](), dict[str, None]()
        for (file, ledger), known in each:
            own, book = loads[file], list(ledger.loads.loads.values())
            if day is not None:
                own = [load for load in own if load.labels["day"] == day]
                book = [load.load for load in own if load.load is not None]
            if own or day is None:
                refused += [known.refused[load.number] for load in book if load.number in known.refused]
                models = [model for load in own for method, model in load.one.totals.sums.weighed if method != "volume"]
                told = (*of_other_weights(known.tickets, models), *ledger_doubts(book, known.tickets, asked))
                doubts |= dict.fromkeys((*known.unread, *known.unshared, *told))
        return AllLoads(loads, refused, list(doubts), {file: ledger.stated for file, ledger in ledgers.items()})


def _told_apart(
    loads: Mapping[Path, list[Labelled]], *, lines: Mapping[Path, Mapping[str, str]]
) -> dict[Path, list[Labelled]]:
    """The same loads; each of those that are called alike, in several ledgers, with its run: of two lines that began
    in the same second with its line, too.

    `lines`: that of each run, by ledger.
    """

    def names(load: Labelled, line: str) -> tuple[str, str, str]:
        label = load.labels["load"]
        return label, f"{label} ({load.run})", f"{label} ({line}, {load.run})"

    told = {file: [names(load, lines[file][load.run]) for load in of_ledger] for file, of_ledger in loads.items()}
    often = Counter(name for of_ledger in told.values() for each in of_ledger for name in each)
    return {
        file: [
            replace(load, labels={**load.labels, "load": next((name for name in each if often[name] == 1), each[-1])})
            for load, each in zip(of_ledger, told[file], strict=True)
        ]
        for file, of_ledger in loads.items()
    }


def _is_of(ticket: Ticket, loads: Sequence[Labelled]) -> bool:
    """Whether a ticket is of one of these loads, or of a run in which one of them has belt."""
    if ticket.kind == "load" and ticket.part.startswith("load "):
        return any(load.load and (load.run, f"load {load.load.number}") == (ticket.run, ticket.part) for load in loads)
    return any(ticket.run in load.runs for load in loads)


def grouped(loads: Sequence[Labelled], by: str) -> list[Total]:
    """The totals of these loads by one of `BY`, in the order in which the labels come; by load each is one by itself,
    also where two are called alike.
    """
    if by == "load":
        return [total_of(load.labels[by], [load]) for load in loads]
    groups: dict[str, list[Labelled]] = {}
    for load in loads:
        label = load.labels[by]
        groups.setdefault(name_key(label) if by in TYPED else label, []).append(load)
    return [total_of(group[0].labels[by], group) for group in groups.values()]


def labelled(ledger: ReadLoads, tickets: Sequence[Ticket]) -> list[Labelled]:
    """Every load of a ledger, runs without loads and what passed without one included, in the order they began."""
    seen = ledger.seen
    found: list[tuple[int, Labelled]] = []
    for load in ledger.loads.loads.values():
        if load.spans and not load.undone:
            counted = count_load(ledger, load, seen)
            one = _of_load(ledger, load, counted, tickets)
            net = load.ticket(net=True)
            net_g = net.ticket_g if net else None
            remarks = ledger.remarks(run for run, _ in load.spans)
            told = Labelled(_labels(load), one, net_g, load, counted.unseen_m, load.run, True, remarks)
            found.append((load.began_ns, told))
    for name, run in ledger.runs.items():
        rest = _rest(ledger, run)
        if rest is not None:
            is_load = name not in ledger.loads.spans
            label = name if is_load else f"{name}, without a load"
            one = _one(rest, tickets, ledger.prior(name), ledger.stated.cultivar)
            labels = _run_labels(label, _harvested_ns(run, seen[name]), ledger.utc_offset_s(name))
            told = Labelled(labels, one, None, None, rest.unseen_m, name, is_load, ledger.remarks([name]))
            found.append((run.started_ns, told))
    return [load for _, load in sorted(found, key=lambda pair: pair[0])]


def run_loads(ledger: ReadLoads, run: RunRow, tickets: Sequence[Ticket]) -> list[OneLoad]:
    """What passed in one run of a ledger, load by load; of a load that went on elsewhere what passed in this run."""
    name, cultivar = run.run, ledger.stated.cultivar
    if name not in ledger.loads.spans:
        return [_one(ledger.whole(run), tickets, ledger.prior(name), cultivar)]
    return loads_in(ledger, name, ledger.seen, tickets, prior_of=ledger.prior, cultivar=cultivar)


def loads_in(
    ledger: Sums,
    run: str,
    seen: Mapping[str, Seen],
    tickets: Sequence[Ticket],
    *,
    prior_of: Callable[[str], Prior],
    cultivar: str,
) -> list[OneLoad]:
    """The same of a run in which loads were started, what passed without one last.

    Args:
        prior_of: what the line stated in a run. cultivar: of loads that name no variety.
    """
    ones = []
    for load in ledger.loads.loads.values():
        if (part := here(load, run)).spans and not load.undone:
            found, variety = count_load(ledger, part, seen), load.variety or cultivar
            ones.append(_one(found, tickets, prior_of(load.run), variety))
    rest = without_load(ledger, run, seen[run])
    return [*ones, *([] if rest is None else [_one(rest, tickets, prior_of(run), cultivar)])]


def _of_load(ledger: ReadLoads, load: Load, found: LoadCounted, tickets: Sequence[Ticket]) -> OneLoad:
    return _one(found, tickets, ledger.prior(load.run), load.variety or ledger.stated.cultivar)


def _rest(ledger: ReadLoads, run: RunRow) -> LoadCounted | None:
    """What passed in a run while no load was open; all of it where none was ever started."""
    name = run.run
    return without_load(ledger, name, ledger.seen[name]) if name in ledger.loads.spans else ledger.whole(run)


def _one(found: LoadCounted, tickets: Sequence[Ticket], prior: Prior, variety: str) -> OneLoad:
    totals = LoadTotals(found.sums, tickets, prior=found.known_before(prior), cultivar=variety)
    return OneLoad(totals, found.coverage, found.belt_m, variety, found.most_m)


def _labels(load: Load) -> dict[str, str]:
    day = time.strftime(DAY, time.gmtime(load.began_ns / 1e9 + load.utc_offset_s))
    name = f"{load.number} {load.name}".strip()
    described = {"field": load.field or NOT_TOLD, "variety": load.variety or NOT_TOLD}
    return {"load": name, **described, "day": day, "season": day[:4]}


def _harvested_ns(run: RunRow, seen: Seen) -> int:
    """When a run's belt passed: as the line was started; of a replay, as its cameras stamped the first frames, where
    they did so with the time of the day.
    """
    stamped = [sight.first_ns for sight in seen.sights.values() if sight.first_ns is not None]
    return min(stamped) if run.line == REPLAY_NAME and stamped and min(stamped) >= DAYS_FROM_NS else run.started_ns


def _run_labels(label: str, began_ns: int, utc_offset_s: int | None) -> dict[str, str]:
    """Its day is by the line's own clock, as that of a load; by this computer's where the ledger states no zone."""
    began_s = began_ns / 1e9
    day = time.strftime(DAY, time.localtime(began_s) if utc_offset_s is None else time.gmtime(began_s + utc_offset_s))
    return {"load": label, "field": NOT_TOLD, "variety": NOT_TOLD, "day": day, "season": day[:4]}


def total_of(label: str, loads: Sequence[Labelled]) -> Total:
    """These loads together."""
    tickets_g = [load.net_g for load in loads if load.net_g is not None]
    sums, raw_g = together_of(loads)
    remarks = tuple(dict.fromkeys(words for load in loads for words in load.remarks))
    count = sum(load.is_load for load in loads)
    return Total(label, count, len(tickets_g), sum(tickets_g), raw_g, sums, remarks, len(loads) - count)


def together_of(loads: Sequence[Labelled]) -> tuple[Together, float]:
    """Some loads together, and the estimate of all of them before any calibration, grams."""
    raw_g = sum(load.one.whole * load.one.totals.sums.as_weighed_g for load in loads)
    return together([load.one for load in loads]), raw_g
