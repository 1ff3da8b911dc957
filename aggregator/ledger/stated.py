"""What a line states of its ledger's loads: tickets, cultivar and densities by the config beside the ledger; of each
run what its tubers lay on.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from aggregator.calibration.tickets import Ticket, read_tickets
from aggregator.ledger.reader import read_summary
from aggregator.ledger.sums import RunSums
from aggregator.ledger.verified import LedgerView
from conveyor.config import LineConfig, load_config
from conveyor.config_yield import ForeignConfig
from conveyor.errors import TuberlineError

CONFIG_FILE, SUMMARY_FILE = "line.toml", "summary.json"


@dataclass(frozen=True, slots=True)
class Stated:
    """`cultivar`: of loads that name no variety. `belt`: as `told_belt` has it. `config`: all of it. Both are None
    where there is no config. `words`: what could not be read, and what that means."""

    tickets: tuple[Ticket, ...] = ()
    cultivar: str = ""
    densities: ForeignConfig | None = None
    belt: Mapping[str, Any] | None = None
    words: tuple[str, ...] = ()
    config: LineConfig | None = None


def stated_beside(ledger: Path) -> Stated:
    """What the config beside `ledger` states; a ledger at rest is told as its line told it.

    What cannot be read ends nothing, for a ledger may have been copied without it: it is in `words`.
    """
    file = ledger.parent / CONFIG_FILE
    if not file.is_file():
        return Stated()
    try:
        config = load_config(file)
    except TuberlineError as error:
        return Stated(words=(f"{error}: tickets and cultivar that it names are left out, contract and densities too",))
    settings = config.aggregator
    tickets: tuple[Ticket, ...] = ()
    words: tuple[str, ...] = ()
    try:
        tickets = read_tickets(settings.tickets) if settings.tickets else ()
    except TuberlineError as error:
        words = (f"{error}: {file} names them, they are left out",)
    return Stated(tickets, settings.cultivar, config.foreign, told_belt(config), words, config)


def told_belt(config: LineConfig) -> dict[str, Any]:
    """What tubers lie on, and how well the belt plane is known: as the summary has it."""
    return {**config.belt.model_dump(), "plane_sd_mm": config.segmenter.belt_sd_mm}


def summary_told(view: LedgerView, run: str, sums: RunSums) -> dict[str, Any]:
    """The summary of a run that has these sums; {} where there is none.

    A line that is stopped before its cameras ended leaves it beside the ledger alone: it is taken where it is of that
    run and of all that is committed.
    """
    if (told := read_summary(view, run)) is not None:
        summary: dict[str, Any] = json.loads(told)
        return summary
    try:
        beside = json.loads((view.path.parent / SUMMARY_FILE).read_text(encoding="utf-8"))
        same = (beside["run"], beside["tubers"]["committed"]) == (run, sums.load.count)
    except (OSError, ValueError, LookupError, TypeError):
        return {}
    return dict(beside) if same else {}


def belt_of_run(view: LedgerView, run: str, sums: RunSums, stated: Stated) -> Mapping[str, Any] | None:
    """What tubers of `run`, which has these sums, lay on, by its summary; by the config beside the ledger where there
    is none yet. None where neither says.
    """
    summary = summary_told(view, run, sums)
    told: Mapping[str, Any] | None = summary.get("belt") if summary else stated.belt
    return told
