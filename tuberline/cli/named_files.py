"""The files that a line's config names for its aggregator, read before anything starts."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from conveyor.config import LineConfig
from conveyor.errors import TuberlineError


def unreadable_files(line: LineConfig) -> list[str]:
    """What cannot be read of them, in words; the aggregator would end with the first of these."""
    from aggregator.calibration.tickets import read_tickets
    from conveyor.contract import read_contract

    settings, reads = line.aggregator, dict[str, Callable[[], object]]()
    if settings.tickets is not None:
        reads["tickets"] = partial(read_tickets, settings.tickets)
    if settings.contract is not None:
        reads["contract"] = partial(read_contract, settings.contract)
    found = []
    for key, read in reads.items():
        try:
            read()
        except TuberlineError as error:
            found.append(f"aggregator.{key}: {error}")
    return found
