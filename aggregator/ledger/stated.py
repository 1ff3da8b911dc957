"""What a line's config states of its ledger's loads, as it lies beside the ledger: tickets, cultivar, densities."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from aggregator.calibration.tickets import Ticket, read_tickets
from conveyor.config import load_config
from conveyor.config_yield import ForeignConfig
from conveyor.errors import TuberlineError

CONFIG_FILE = "line.toml"


@dataclass(frozen=True, slots=True)
class Stated:
    """`cultivar`: of loads that name no variety. `words`: what could not be read, and what that means."""

    tickets: tuple[Ticket, ...] = ()
    cultivar: str = ""
    densities: ForeignConfig | None = None
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
    return Stated(tickets, settings.cultivar, config.foreign, words)
