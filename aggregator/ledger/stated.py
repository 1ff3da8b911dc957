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
from aggregator.ledger.verified import LedgerView
from conveyor.config import LineConfig, load_config
from conveyor.config_yield import ForeignConfig
from conveyor.errors import TuberlineError

CONFIG_FILE = "line.toml"


@dataclass(frozen=True, slots=True)
class Stated:
    """`cultivar`: of loads that name no variety. `belt`: as `told_belt` has it; None where there is no config. `words`:
    what could not be read, and what that means."""

    tickets: tuple[Ticket, ...] = ()
    cultivar: str = ""
    densities: ForeignConfig | None = None
    belt: Mapping[str, Any] | None = None
    words: tuple[str, ...] = ()


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
        return Stated(words=(f"{error}: tickets and cultivar that it names are left out",))
    settings = config.aggregator
    tickets: tuple[Ticket, ...] = ()
    words: tuple[str, ...] = ()
    try:
        tickets = read_tickets(settings.tickets) if settings.tickets else ()
    except TuberlineError as error:
        words = (f"{error}: {file} names them, they are left out",)
    return Stated(tickets, settings.cultivar, config.foreign, told_belt(config), words)


def told_belt(config: LineConfig) -> dict[str, Any]:
    """What tubers lie on, and how well the belt plane is known: as the summary has it."""
    return {**config.belt.model_dump(), "plane_sd_mm": config.segmenter.belt_sd_mm}


def belt_of_run(view: LedgerView, run: str, stated: Stated) -> Mapping[str, Any] | None:
    """What tubers of `run` lay on, by its summary; by the config beside the ledger where the run has not ended, for
    only then it has none. None where neither says.
    """
    summary = read_summary(view, run)
    told: Mapping[str, Any] | None = json.loads(summary).get("belt") if summary else stated.belt
    return told
