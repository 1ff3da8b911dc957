"""The options that `tuberline calibrate bucket`, `tubers` and `load` share: where a ticket goes, and of which part."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cyclopts import Parameter

from tuberline.cli.numbers import RestingOffset

if TYPE_CHECKING:
    from aggregator.calibration.part import Part
    from aggregator.calibration.tickets import Ticket


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class TicketOptions:
    """Where a ticket is kept, and what the run that it weighs was.

    Parameters
    ----------
    tickets
        File of tickets; made where it does not exist. Name it as aggregator.tickets in the line's file.
    run
        Which run, where the ledger holds several.
    again
        Replace the ticket that this run or part has already, and those of parts that overlap with it.
    cultivar
        Name of the cultivar; each gets a factor of its own. Name it as aggregator.cultivar for runs to come.
    resting_offset_mm
        Resting offset that the run was weighed with; default: what the run states.
    """

    tickets: Path = Path("tickets.json")
    run: str | None = None
    again: bool = False
    cultivar: str = ""
    resting_offset_mm: RestingOffset | None = None

    def add(self, ticket: Ticket) -> tuple[Ticket, ...]:
        """All tickets of the file, which is made where it does not exist, with one more.

        Raises:
            InputError: the file cannot be read, or has this ticket already.
        """
        from aggregator.calibration.tickets import read_tickets, with_ticket, write_tickets

        known = read_tickets(self.tickets) if self.tickets.exists() else ()
        known = with_ticket(known, ticket, again=self.again)
        write_tickets(self.tickets, known)
        return known


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class PartOptions:
    """The part of a run that was weighed; all of it where nothing is said.

    Parameters
    ----------
    first
        Id of the first tuber that was weighed, where it is a part of the run (see tubers.csv).
    last
        Id of the last one.
    from_x
        Where the part begins by its place on the belt, metres (place_x_m in tubers.csv).
    to_x
        Where it ends, metres.
    """

    first: int | None = None
    last: int | None = None
    from_x: float | None = None
    to_x: float | None = None

    def part(self) -> Part:
        """As the calibration takes it."""
        from aggregator.calibration.part import Part

        return Part(self.first, self.last, self.from_x, self.to_x)


NO_TICKET_OPTIONS = TicketOptions()
"""tickets.json, the ledger's only run."""
WHOLE_RUN = PartOptions()
"""No part is named."""
