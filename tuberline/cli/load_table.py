"""Loads of a line or a ledger as a person reads them."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import quote

from rich.console import Console
from rich.table import Table
from rich.text import Text

from conveyor.errors import InputError
from conveyor.heights import heights_told
from conveyor.messages import HeightChange
from conveyor.messages.loads import is_meant
from conveyor.zone import local_clock
from tuberline.cli.address import LineAddress
from tuberline.cli.units import GRAMS, digits_of, in_unit, ticket_in

TICKET = re.compile(r"(?:net|gross) ticket [\d.]+ kg")
"""What the ledger says of a ticket in a load's history."""
MOST_ASKED = 50
"""Of a running line."""
OF_RUN = "its run"
"""Said by no one: a load is open no more when its run ends."""
NAMED = 8
"""In an error."""
DESCRIBED = ("trailer", "field", "variety", "customer", "operator")


def told_loads(address: LineAddress, ledger: Path | None, *, wanted: str, limit: int) -> list[dict[str, Any]]:
    """The loads of a ledger, or of the one that a running line writes, the newest first; or those that are wanted.

    Args:
        wanted: a number, 'number:' and a number, or a name; all loads that have it.

    Raises:
        InputError: none of that number or name.
    """
    if ledger is not None:
        from aggregator.ledger.load_list import told_loads as of_ledger
        from aggregator.ledger.reader import ledger_file, reading

        with reading(ledger_file(ledger)) as view:
            return _found(lambda wanted, most: of_ledger(view, limit=most, wanted=wanted), wanted, limit)
    from conveyor import topics
    from conveyor.observer import Observer

    link, name = address.link()
    with Observer(link, line=name) as observer:

        def ask(wanted: str, most: int) -> list[dict[str, Any]]:
            asked = f"limit={min(most, MOST_ASKED)};what=loads;load={quote(wanted, safe='')}"
            loads: list[dict[str, Any]] = observer.query(topics.QUERY_LOADS, parameters=asked)
            return loads

        return _found(ask, wanted, limit)


def _found(ask: Callable[[str, int], list[dict[str, Any]]], wanted: str, limit: int) -> list[dict[str, Any]]:
    """What `ask` tells, given (wanted, at most so many); an aggregator before 0.2 tells of its last ones, all the same.

    Raises:
        InputError: none is wanted.
    """
    if not wanted:
        return ask("", limit)
    loads = ask(wanted, MOST_ASKED)
    if found := [load for load in loads if is_meant(wanted, number=load["number"], name=load["name"])]:
        return found
    known = ", ".join(f"{load['number']} ({load['name']})" for load in ask("", NAMED))
    raise InputError(f"no load {wanted!r} is there; {f'the newest are {known}' if known else 'none was started yet'}")


def print_loads(loads: list[dict[str, Any]], *, unit: str = "kg", limit: int = 20) -> None:
    """One line a load, below them what is to be said of their tickets, and that there are older ones than the `limit`
    that were asked for; weights in `unit`, one of `units.GRAMS`.
    """
    console = Console()
    if not loads:
        console.print("no load was started: each run is one load by itself; tuberline load start NAME begins one")
        return
    table = Table("", "load", "began", "ended", "tubers", f"{unit}, all belt\n(90 %)", "seen", "ticket", box=None)
    for column in (table.columns[0], *table.columns[2:]):
        column.no_wrap = True
    table.columns[1].min_width = 11
    for load in loads:
        said = [load["name"], *(load[name] for name in DESCRIBED)]
        table.add_row(
            str(load["number"]),
            Text(", ".join(filter(None, said))),
            "\n".join(local_clock(load["began_unix_s"], "%m-%d %H:%M")),
            _ended(load),
            str(load["count"]),
            _weight(load, unit),
            "-" if load["coverage"] is None else f"{100 * load['coverage']:.1f} %",
            "" if load["net_g"] is None else ticket_in(load["net_g"], unit).removesuffix(f" {unit}"),
        )
    console.print(table)
    names = [load["name"] for load in loads]
    for load in loads:
        for words in _of_tickets(load):
            console.print(Text(f"{load['number']}: {in_unit(words, unit, names=names)}"))
    for words in dict.fromkeys(words for load in loads for words in load.get("remarks", ())):
        console.print(Text(words))
    if len(loads) in (limit, MOST_ASKED) and loads[-1]["number"] > 1:
        console.print(
            f"older loads, up to number {loads[-1]['number'] - 1}, are there: --limit says how many are shown, at most "
            f"{MOST_ASKED} of a running line and any number of --ledger RUN"
        )


def _weight(load: dict[str, Any], unit: str) -> str:
    """No weight where no belt was seen, which is not one of 0 kg."""
    if not load["count"] and not load["coverage"]:
        return "-"
    return weight_told(load["estimated_weight_g"], load["estimated_low_g"], load["estimated_high_g"], unit=unit)


def _of_tickets(load: dict[str, Any]) -> list[str]:
    """Why its ticket does not calibrate, and what speaks against its tickets."""
    refused = [f"its ticket does not calibrate: {words}" for words in load.get("refused", ())]
    return [*refused, *load.get("doubts", ())]  # a line of an earlier version tells no doubts and no remarks


def print_load(load: dict[str, Any], *, unit: str = "kg") -> None:
    """One load with all that was said of it."""
    console = Console()
    print_loads([load], unit=unit)
    for said in load["said"]:
        text = in_unit(said["text"], unit) if TICKET.fullmatch(said["text"]) else said["text"]  # not of a person's note
        console.print(Text(f"{_clock(said['unix_s'])}  {said['by'] or 'unknown'}: {text}"))
    if _ended(load) == OF_RUN:
        console.print("ended with its run")
    for change in load.get("heights", ()):
        console.print(Text(heights_told(HeightChange(**change))))


def weight_told(middle_g: float, low_g: float, high_g: float, *, unit: str = "kg") -> str:
    """Kilograms, or another unit, with four figures or so, the interval below; it is not the same to both sides."""
    digits = digits_of(middle_g, unit)
    low, middle, high = (f"{grams / GRAMS[unit]:.{digits}f}" for grams in (low_g, middle_g, high_g))
    return f"{middle}\n{low} to {high}"


def _ended(load: dict[str, Any]) -> str:
    if load["undone"] or load["open"]:
        return "undone" if load["undone"] else "open"
    return OF_RUN if load["ended_unix_s"] is None else "\n".join(local_clock(load["ended_unix_s"], "%H:%M"))


def _clock(unix_s: float) -> str:
    return " ".join(local_clock(unix_s, "%Y-%m-%d %H:%M:%S"))
