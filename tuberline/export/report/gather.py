"""What a day came to, read from the ledgers: loads, sums, classes, foreign matter, and what is said of the runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from aggregator.core.class_totals import class_totals, classes_together
from aggregator.core.foreign_totals import foreign_total
from aggregator.core.load_sums import CameraDoubt, LoadSums
from aggregator.core.totals import LoadTotals
from aggregator.ledger.ends import End, end_of
from aggregator.ledger.reader import all_runs, read_sums, reading, run_being_written
from aggregator.ledger.stated import summary_told
from aggregator.ledger.totals_by import ALL, Labelled, Total, all_loads, grouped, total_of
from conveyor.config import LineConfig
from conveyor.config_yield import ForeignConfig
from conveyor.contract import Contract, SizeClass, read_contract
from conveyor.errors import InputError
from conveyor.messages import ClassTotal, ForeignTotal
from conveyor.zone import zone_told

PLAIN = Contract(
    classes=tuple(
        SizeClass(name=name, from_mm=low, to_mm=high)
        for name, low, high in (
            ("below 35", None, 35.0),
            ("35 to 45", 35.0, 45.0),
            ("45 to 55", 45.0, 55.0),
            ("55 to 65", 55.0, 65.0),
            ("65 and more", 65.0, None),
        )
    )
)
"""Classes where no contract is given: by square mesh, mm."""


@dataclass(frozen=True, slots=True)
class LoadFacts:
    """One load: what was said of it and what it came to; kilograms for its whole belt.

    `day` (YYYY-MM-DD) is that of its beginning. `began`, `ended` are the line's own time of day, '' where not known,
    `zone` the one that they are of. `ticket_kg` None: not weighed.
    """

    label: str
    field: str
    variety: str
    day: str
    began: str
    ended: str
    zone: str
    tubers: int
    raw_kg: float
    kg: float
    low_kg: float
    high_kg: float
    coverage: float | None
    saw: bool
    unseen_m: dict[str, float]
    ticket_kg: float | None
    classes: tuple[ClassTotal, ...]
    foreign: ForeignTotal | None


@dataclass(frozen=True, slots=True)
class RunFacts:
    """One run as its summary has it; `summary` is empty where there is none yet. `models`: tubers by weights. `loads`:
    numbers of the loads that are told. `alarms`: where the line's config keeps them, None where it does not say.
    `lacks`: a repair could not save all of it.
    """

    path: Path
    run: str
    line: str
    version: str
    summary: dict[str, Any]
    end: End
    models: dict[str, int]
    loads: frozenset[int]
    alarms: Path | None
    lacks: bool


@dataclass(frozen=True, slots=True)
class DayFacts:
    """All that a report tells; `runs` are those in which something of these days was. `refused`: tickets of
    these loads that do not calibrate, `doubts`: what speaks against others.
    """

    days: tuple[str, ...]
    loads: tuple[LoadFacts, ...]
    total: Total
    by_field: tuple[Total, ...]
    by_variety: tuple[Total, ...]
    contract: Contract
    classes: tuple[ClassTotal, ...]
    foreign: ForeignTotal | None
    calibrated_by: tuple[str, ...]
    camera_doubt: CameraDoubt
    late: int
    refused: tuple[str, ...]
    doubts: tuple[str, ...]
    runs: tuple[RunFacts, ...]


def day_facts(runs: Sequence[Path], *, day: str | None = None, contract: Path | None = None) -> DayFacts:
    """Read the loads of `day` (YYYY-MM-DD); all of the runs' where it is not given.

    Raises:
        InputError: no load on that day; the text says which days there are. LedgerError: a ledger cannot be trusted.
    """
    read = all_loads(runs, day=day)
    found = read.loads
    days = sorted({load.labels["day"] for load in found})
    # Belt without a load that carried nothing is nothing to tell.
    found = [load for load in found if load.load is not None or load.one.totals.sums.count] or found
    loads = [load for load in found if day in (None, load.labels["day"])]
    if not loads:
        raise InputError(f"these runs hold no load of {day}: they hold {', '.join(days) or 'none at all'}")
    configs = {path: stated.config for path, stated in read.stated.items() if stated.config is not None}
    chosen, densities = _settings(list(configs.values()), contract)
    whole = LoadSums(loads[0].one.totals.sums.histogram_step_g)
    for load in loads:
        whole.take(load.one.totals.sums)
    ones = [load.one for load in loads]
    return DayFacts(
        days=tuple(sorted({load.labels["day"] for load in loads})),
        loads=tuple(_load(load, chosen, densities) for load in loads),
        total=total_of(ALL, loads),
        by_field=tuple(grouped(loads, "field")),
        by_variety=tuple(grouped(loads, "variety")),
        contract=chosen,
        classes=classes_together([one.totals for one in ones], chosen, whole=[one.whole for one in ones]),
        foreign=foreign_total(LoadTotals(whole), densities, weight_g=sum(one.totals.weight_g for one in ones)),
        calibrated_by=tuple(dict.fromkeys(filter(None, (load.one.totals.calibrated().told for load in loads)))),
        camera_doubt=whole.camera_doubt(),
        late=whole.late,
        refused=tuple(read.refused),
        doubts=tuple(read.doubts),
        runs=tuple(run for path, of_ledger in read.by_ledger.items() for run in _runs(path, of_ledger, day, configs)),
    )


def _settings(configs: Sequence[LineConfig], contract: Path | None) -> tuple[Contract, ForeignConfig]:
    """The contract given, else that of the first line's config that has one; densities likewise."""
    named = contract or next((c.aggregator.contract for c in configs if c.aggregator.contract), None)
    return read_contract(named) if named else PLAIN, configs[0].foreign if configs else ForeignConfig()


def _load(found: Labelled, contract: Contract, densities: ForeignConfig) -> LoadFacts:
    one, load = found.one, found.load
    kg, low_kg, high_kg = (grams / 1000 for grams in one.estimated)
    offset_s = load.utc_offset_s if load else 0
    return LoadFacts(
        label=found.labels["load"],
        field=load.field if load else "",
        variety=load.variety if load else "",
        day=found.labels["day"],
        began=_clock(load.began_ns, offset_s) if load else "",
        ended=_clock(load.ended_ns, offset_s) if load and load.ended_ns else "",
        zone=zone_told(offset_s) if load else "",
        tubers=one.totals.sums.count,
        raw_kg=one.whole * one.totals.sums.as_weighed_g / 1000,
        kg=kg,
        low_kg=low_kg,
        high_kg=high_kg,
        coverage=one.coverage,
        saw=one.saw,
        unseen_m=dict(found.unseen_m),
        ticket_kg=None if found.net_g is None else found.net_g / 1000,
        classes=class_totals(one.totals, contract),
        foreign=foreign_total(one.totals, densities),
    )


def _runs(file: Path, loads: Sequence[Labelled], day: str | None, configs: Mapping[Path, LineConfig]) -> list[RunFacts]:
    """Those of a ledger, or those in which something of `day` was, be it only belt."""
    alarms = configs[file].alarms if file in configs else None
    kept = alarms.state_dir if alarms is not None else None
    told = [load for load in loads if day in (None, load.labels["day"])]
    of_day = {run for load in told for run in load.runs}
    numbers = frozenset(load.load.number for load in told if load.load is not None)
    with reading(file) as view:
        written, found = run_being_written(view), []
        for run in (run for run in all_runs(view, file) if day is None or run.run in of_day):
            sums = read_sums(view, run.run)
            summary = summary_told(view, run.run, sums)
            end = end_of(run, written, sums=sums, summary=summary)
            of = (run.run, run.line, run.version, summary, end, sums.load.models())
            found.append(RunFacts(file, *of, numbers, kept, sums.lacks))
        return found


def _clock(unix_ns: int, offset_s: int) -> str:
    return (datetime.fromtimestamp(unix_ns / 1e9, UTC) + timedelta(seconds=offset_s)).strftime("%H:%M")
