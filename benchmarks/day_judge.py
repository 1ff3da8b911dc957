"""The simulated day's loads, classes and foreign matter against the truth, as Markdown tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from aggregator.calibration.tickets import Ticket
from aggregator.core.class_totals import class_totals
from aggregator.core.foreign_totals import foreign_total
from aggregator.core.load_sums import LoadSums
from aggregator.core.totals import LoadTotals
from aggregator.ledger.load_totals import ReadLoads, tickets_of
from aggregator.ledger.reader import reading
from aggregator.ledger.totals_by import Labelled, labelled
from benchmarks.day_belts import Belt
from benchmarks.day_world import DayPlan
from benchmarks.foreign import SIMULATED, large
from conveyor.contract import Contract

BAR_PERCENT = 3.0
WHOLE = 0.99


@dataclass(frozen=True, slots=True)
class Judged:
    """A load by the ledger: kilograms for its whole belt with their interval; the truth; whether it was seen whole."""

    whole: bool
    true_kg: float
    kg: float
    low_kg: float
    high_kg: float

    @property
    def error(self) -> float:
        """Percent of the truth."""
        return 100 * (self.kg / self.true_kg - 1)

    @property
    def held(self) -> bool:
        """The truth lies in the interval."""
        return self.low_kg <= self.true_kg <= self.high_kg


class Evening:
    """The loads of the day's ledger, to be totalled with any of the tickets entered."""

    def __init__(self, ledger: Path, true_kg: Sequence[float]) -> None:
        self._path = ledger
        self._true_kg = list(true_kg)
        with reading(ledger) as view:
            read = ReadLoads(view)
            self.tickets, _ = tickets_of(read, read.seen)

    def loads(self, tickets: Sequence[Ticket]) -> list[Labelled]:
        """Every load started, in order, calibrated by these tickets alone."""
        with reading(self._path) as view:
            return [load for load in labelled(ReadLoads(view), tickets) if load.load is not None]

    def judged(self, tickets: Sequence[Ticket]) -> list[Judged]:
        """The same against the truth."""
        found = []
        for load, true_kg in zip(self.loads(tickets), self._true_kg, strict=True):
            grams = load.one.estimated
            whole = (load.one.coverage or 0) > WHOLE
            found.append(Judged(whole, true_kg, *(value / 1000 for value in grams)))
        return found


def stages(evening: Evening, plan: DayPlan) -> dict[str, list[Judged]]:
    """Loads that were not on the scale themselves, after none, one, three and all tickets."""
    by_part = {ticket.part: ticket for ticket in evening.tickets}
    of_load = [by_part.get(f"load {load.number}") for load in plan.loads]
    firsts = [n for n, load in enumerate(plan.loads) if n == 0 or load.stock != plan.loads[n - 1].stock]

    def without(chosen: Sequence[int]) -> list[Judged]:
        tickets = [ticket for n in chosen if (ticket := of_load[n]) is not None]
        return [one for n, one in enumerate(evening.judged(tickets)) if n not in chosen]

    found = {"no ticket": without([]), "the first load's ticket": without([0])}
    whole = [n for n, load in enumerate(evening.loads([])) if (load.one.coverage or 0) > WHOLE]
    found["any one load's ticket, seen whole"] = [one for n in whole for one in without([n])]
    usable = [n for n, ticket in enumerate(of_load) if ticket is not None]
    found["any one load's ticket"] = [one for n in usable for one in without([n])]
    found["one ticket of each variety"] = without(firsts)
    found["tickets of all other loads"] = [
        evening.judged([t for k, t in enumerate(of_load) if t is not None and k != n])[n] for n in range(len(of_load))
    ]
    return {name: loads for name, loads in found.items() if loads}


def stage_table(found: dict[str, list[Judged]]) -> str:
    """Markdown: errors and intervals after each stage."""
    lines = [
        "| calibrated with | loads judged | mean error % | error %, 90th percentile | of those seen whole | largest "
        "| stated +- % (median) | held |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for name, loads in found.items():
        errors = np.array([load.error for load in loads])
        half = np.median([50 * (load.high_kg - load.low_kg) / load.kg for load in loads])
        p90 = f"{np.quantile(np.abs(errors), 0.9):.1f}"
        bar = f" (bar {BAR_PERCENT:g})" if "one load" in name or "first" in name else ""
        whole = np.quantile(np.abs([load.error for load in loads if load.whole] or [np.nan]), 0.9)
        held = sum(load.held for load in loads)
        lines.append(
            f"| {name} | {len(loads)} | {errors.mean():+.1f} | {p90}{bar} | {whole:.1f} | {np.abs(errors).max():.1f} "
            f"| {half:.1f} "
            f"| {held} of {len(loads)} ({100 * held / len(loads):.0f} %) |"
        )
    return "\n".join(lines) + "\n"


def load_table(evening: Evening, plan: DayPlan, belts: Sequence[Belt]) -> str:
    """Markdown: every load with the first load's ticket alone."""
    tickets = [ticket for ticket in evening.tickets if ticket.part == f"load {plan.loads[0].number}"]
    raw, after, loads = evening.judged([]), evening.judged(tickets), evening.loads(tickets)
    lines = [
        "| load | variety | tubers | counted | seen % | true kg | raw off % | kg (90 %) | off % | |",
        "| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | --- |",
    ]
    for n, load in enumerate(plan.loads):
        one, told = after[n], "ticket" if n == 0 else "" if after[n].held else "missed"
        weight = f"{one.kg:.1f} ({one.low_kg:.1f} to {one.high_kg:.1f})"
        lines.append(
            f"| {load.name} | {load.stock.cultivar} | {len(belts[n].truth['tubers'])} "
            f"| {loads[n].one.totals.sums.count} | {100 * (loads[n].one.coverage or 0):.0f} | {one.true_kg:.1f} "
            f"| {raw[n].error:+.1f} | {weight} | {one.error:+.1f} | {told} |"
        )
    return "\n".join(lines) + "\n"


def class_table(evening: Evening, plan: DayPlan, belts: Sequence[Belt], contract: Contract) -> str:
    """Markdown: share of weight by class, for each variety: as weighed, and after the first load's ticket alone."""
    names = [each.name for each in contract.classes]
    lines = [
        f"| loads | tubers | calibrated with | {' | '.join(names)} | largest difference |",
        "| --- | ---: | --- |" + " ---: |" * (len(names) + 1),
    ]
    loads, groups = evening.loads([]), _groups(plan)
    by_part = {ticket.part: ticket for ticket in evening.tickets}
    for name, chosen in groups.items():
        sums = _summed([loads[n] for n in chosen])
        rows = [row for n in chosen for row in belts[n].truth["tubers"]]
        grams, mesh = (np.array([row[key] for row in rows]) for key in ("weight_g", "square_mesh_mm"))
        own = by_part.get(f"load {plan.loads[chosen[0]].number}")
        first = by_part.get(f"load {plan.loads[0].number}")
        stages = {"no ticket": None, "the first load's ticket": first, "the variety's first ticket": own}
        for stage, ticket in stages.items():
            if stage != "no ticket" and (
                ticket is None or name == "all" or (ticket is first) != ("first load" in stage)
            ):
                continue
            cultivar = "" if name == "all" else name
            totals = LoadTotals(sums, [ticket] if ticket else [], cultivar=cultivar)
            cells, worst = [], 0.0
            for each, told in zip(contract.classes, class_totals(totals, contract), strict=True):
                true = 100 * float(grams[(mesh >= each.low_mm) & (mesh < each.high_mm)].sum() / grams.sum())
                held = told.percent_low - 0.05 <= true <= told.percent_high + 0.05
                interval = f"{told.percent:.1f} ({told.percent_low:.0f} to {told.percent_high:.0f})"
                cells.append(f"{interval}, true {true:.1f}" + ("" if held else ", missed"))
                worst = max(worst, abs(told.percent - true))
            lines.append(f"| {name} | {sums.count} | {stage} | {' | '.join(cells)} | {worst:.1f} |")
    return "\n".join(lines) + "\n"


def foreign_table(evening: Evening, plan: DayPlan, belts: Sequence[Belt]) -> str:
    """Markdown: share of foreign matter by count and by weight, for each variety and the day."""
    lines = [
        "| loads | others | % by count | true | off | % by weight | true | off |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    loads = evening.loads(evening.tickets)
    for name, chosen in _groups(plan).items():
        found = foreign_total(LoadTotals(_summed([loads[n] for n in chosen])), SIMULATED)
        tubers = [row for n in chosen for row in belts[n].truth["tubers"]]
        others = [row for n in chosen for row in belts[n].truth["distractor_places"] if large(row)]
        if found is None:
            continue
        count = 100 * len(others) / (len(others) + len(tubers))
        grams = [sum(row["weight_g"] for row in rows) for rows in (others, tubers)]
        weight = 100 * grams[0] / sum(grams)
        lines.append(
            f"| {name} | {len(others)} | {found.percent:.1f} ({found.percent_low:.1f} to {found.percent_high:.1f}) "
            f"| {count:.1f} | {found.percent - count:+.1f} | {found.weight_percent:.1f} "
            f"({found.weight_percent_low:.1f} to {found.weight_percent_high:.1f}) | {weight:.1f} "
            f"| {found.weight_percent - weight:+.1f} |"
        )
    return "\n".join(lines) + "\n"


def _groups(plan: DayPlan) -> dict[str, list[int]]:
    """Indices of loads by variety, and of all."""
    found: dict[str, list[int]] = {}
    for n, load in enumerate(plan.loads):
        found.setdefault(load.stock.cultivar, []).append(n)
    return {**found, "all": list(range(len(plan.loads)))}


def _summed(loads: Sequence[Labelled]) -> LoadSums:
    whole = LoadSums(loads[0].one.totals.sums.histogram_step_g)
    for load in loads:
        whole.take(load.one.totals.sums)
    return whole
