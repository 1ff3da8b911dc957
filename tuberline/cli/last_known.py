"""What is said of a line's load while its aggregator, who tells the totals, is not there."""

from __future__ import annotations

from typing import Any

from conveyor.errors import TuberlineError
from tuberline.cli.address import LineAddress


def last_known(address: LineAddress) -> dict[str, Any] | None:
    """The newest run of the line's ledger (`aggregator.ledger.loads.last_loads`); None where no config is given, or
    where the ledger is another line's, is on another machine or cannot be read.
    """
    if address.config is None or address.line not in (None, address.loaded().name):
        return None
    from aggregator.ledger.loads import last_loads
    from aggregator.ledger.reader import ledger_file, reading

    try:
        with reading(ledger_file(address.loaded().aggregator.out)) as view:
            return next(iter(last_loads(view, limit=1)), None)
    except TuberlineError:  # `tuberline ledger check` says what is wrong with it
        return None


def told_without_aggregator(known: dict[str, Any] | None) -> str:
    """Two lines for a person; `known` as `last_known` gives it."""
    told = "[red]the aggregator is not there[/]: nothing is added up until it is back"
    if known is None:
        return f"{told}\nwhat was counted before is not known here: give --config on the machine that has the ledger"
    return f"{told}\n{ledger_line(known)}"


def ledger_line(known: dict[str, Any]) -> str:
    """One line of what the ledger holds."""
    tubers = f"{known['count']} tuber{'' if known['count'] == 1 else 's'}"
    grams = known["weight_g"]
    came_to = "nothing was seen" if grams is None else f"[bold]{tubers}[/], {_weight(grams, known)}"
    return f"its ledger tells of run {known['run']}: {came_to}"


def _weight(grams: float, known: dict[str, Any]) -> str:
    low_g, high_g = known["low_g"], known["high_g"]
    return f"{grams / 1000:.2f} kg (90 %: {low_g / 1000:.2f} to {high_g / 1000:.2f} kg)"
