"""`tuberline load`: start and end loads while the line goes on, note what is to be remembered, enter tickets."""

from __future__ import annotations

import json as json_module
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from threading import Timer
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import App, Parameter

from tuberline.cli.address import NO_ADDRESS, LineAddress
from tuberline.cli.numbers import ScaleErrorKg, TicketKg, within

if TYPE_CHECKING:
    from conveyor.messages import LoadOrder

SAY_AFTER_S = 3.0
"""Without an answer for so long, a command about a load says that it waits."""

SLOWEST_START_S = 60.0
"""A process that is older was not started for this order."""

load = App(name="load", help="Loads of a running line: start, end, note, ticket, undo, show.")


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class Described:
    """What is known of a load.

    Parameters
    ----------
    trailer
        What carries it.
    field
        Where it was lifted.
    variety
        Named as with tickets: a variety has its own factor in the calibration.
    customer
        Who gets it.
    operator
        Who works the line.
    """

    trailer: str = ""
    field: str = ""
    variety: str = ""
    customer: str = ""
    operator: str = ""

    def fields(self, name: str) -> dict[str, str]:
        """Those given, with the load's name."""
        return {key: text for key, text in {"name": name, **asdict(self)}.items() if text}


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class Asking:
    """How an order is asked for.

    Parameters
    ----------
    by
        Who asks; default: the user of this machine.
    request
        Id of this order, by which it is done once however often it is asked for; default: a new one.
    wait_s
        How long to wait for the line's router, and from then on for an answer.
    json
        For machines.
    """

    by: str | None = None
    request: str | None = None
    wait_s: Annotated[float, within(0, 3600, "s")] = 20.0
    json: bool = False

    def order(self, action: str, **values: object) -> LoadOrder:
        """The order with its id and who asks."""
        import getpass

        from conveyor.load_orders import new_request
        from conveyor.messages import LoadOrder

        who = self.by if self.by is not None else getpass.getuser()
        return LoadOrder(self.request or new_request(), action, by=who, **values)  # type: ignore[arg-type]


NOTHING_KNOWN, BY_DEFAULT = Described(), Asking()


@load.command
def start(
    name: str = "",
    /,
    *,
    known: Described = NOTHING_KNOWN,
    note: str = "",
    resume: str = "",
    address: LineAddress = NO_ADDRESS,
    asking: Asking = BY_DEFAULT,
) -> None:
    """Start a load: from what lies at the cameras' centre row now, tubers belong to it. The open load ends there.

    Parameters
    ----------
    name
        What the load is called, e.g. 'trailer 7'.
    note
        Anything else.
    resume
        A load that has ended, by number or name, goes on instead of a new one.
    """
    order = asking.order("start", load=resume, note=note, fields=known.fields(name))
    _ask(order, address, None, asking)


@load.command
def end(*, note: str = "", address: LineAddress = NO_ADDRESS, asking: Asking = BY_DEFAULT) -> None:
    """End the open load: what comes from now on belongs to none until the next one starts.

    Parameters
    ----------
    note
        Anything to be remembered of it.
    """
    _ask(asking.order("end", note=note), address, None, asking)


@load.command
def undo(*, address: LineAddress = NO_ADDRESS, asking: Asking = BY_DEFAULT) -> None:
    """Undo the last start or end, within a minute: its tubers go to where they would have gone."""
    _ask(asking.order("undo"), address, None, asking)


@load.command
def note(
    text: str = "",
    /,
    *,
    load: str = "",
    name: str = "",
    known: Described = NOTHING_KNOWN,
    ledger: Path | None = None,
    address: LineAddress = NO_ADDRESS,
    asking: Asking = BY_DEFAULT,
) -> None:
    """Remember something of a load, or correct what is known of it; what was there before is kept.

    Parameters
    ----------
    text
        The note.
    load
        Number, name, or number:3, the number alone; default: the open load, or the last one.
    name
        What it is called from now on.
    ledger
        Folder of a run, or its ledger.db, that no line is writing; instead of a running line.
    """
    _ask(asking.order("note", load=load, note=text, fields=known.fields(name)), address, ledger, asking)


@load.command
def ticket(
    load: str = "",
    /,
    *,
    kg: TicketKg | None = None,
    gross: bool = False,
    scale_error_kg: ScaleErrorKg | None = None,
    withdraw: bool = False,
    note: str = "",
    ledger: Path | None = None,
    address: LineAddress = NO_ADDRESS,
    asking: Asking = BY_DEFAULT,
) -> None:
    """Enter what a scale said of a load. A second ticket takes the place of the first, which is kept.

    Net tickets calibrate the totals of this ledger's loads; gross ones say how much soil and stones came with them.

    Parameters
    ----------
    load
        Number, name, or number:3, the number alone; default: the open load, or the last one.
    kg
        What was on the trailer, without the trailer.
    gross
        With soil and stones; else tubers alone (net).
    scale_error_kg
        Standard deviation of the scale; default: 0.5 % of the ticket.
    withdraw
        The ticket before was wrong, and there is none.
    note
        Anything to be remembered, e.g. why it is corrected.
    ledger
        Folder of a run, or its ledger.db, that no line is writing; instead of a running line.
    """
    from conveyor.errors import InputError

    if (kg is None) != withdraw:
        raise InputError("give what the scale said with --kg, or --withdraw for a ticket that was wrong")
    order = asking.order("ticket", load=load, kg=kg, net=not gross, scale_error_kg=scale_error_kg, note=note)
    _ask(order, address, ledger, asking)


@load.command
def show(
    load: str = "",
    /,
    *,
    ledger: Path | None = None,
    address: LineAddress = NO_ADDRESS,
    limit: Annotated[int, within(1, 100_000)] = 20,
    unit: Literal["kg", "t", "lb"] = "kg",
    json: bool = False,
) -> None:
    """Print the loads of a running line, or of a ledger, the newest first; or one load with all that was said of it.

    Parameters
    ----------
    load
        Number, number:3 or name: all that have it, however old; default: all loads.
    ledger
        Folder of a run, or its ledger.db; instead of a running line.
    limit
        How many, at most 50 of a running line.
    unit
        Of weights, tickets and what is said of them.
    json
        For machines; in grams.
    """
    from tuberline.cli.load_table import print_load, print_loads, told_loads

    loads = told_loads(address, ledger, wanted=load, limit=limit)
    if json:
        sys.stdout.write(json_module.dumps(loads, indent=2) + "\n")
    elif load:
        for one in loads:
            print_load(one, unit=unit)
    else:
        print_loads(loads, unit=unit, limit=limit)


def _since_typed_s() -> float:
    """Since this process was started, seconds: on a busy machine Python alone takes some, and the belt runs on. 0 where
    the system does not tell.
    """
    try:
        started = Path("/proc/self/stat").read_text().rpartition(")")[2].split()[19]
        age_s = time.clock_gettime(time.CLOCK_BOOTTIME) - int(started) / os.sysconf("SC_CLK_TCK")
    except (OSError, AttributeError, IndexError, ValueError):  # not Linux
        return 0.0
    return age_s if 0 <= age_s <= SLOWEST_START_S else 0.0


@contextmanager
def _told_while_waiting(router: str, wait_s: float) -> Iterator[None]:
    """Who stands beside the belt learns that the order is under way, and that it is not late."""
    text = (
        f"tuberline: no answer by {router} yet; asking for {wait_s:g} s. The order is about the moment at which it was "
        "given, whenever the answer comes\n"
    )
    word = Timer(SAY_AFTER_S, lambda: sys.stderr.write(text))
    word.daemon = True
    word.start()
    try:
        yield
    finally:
        word.cancel()


def _ask(order: LoadOrder, address: LineAddress, ledger: Path | None, asking: Asking) -> None:
    """Have `order` carried out by the line, or in a ledger at rest, and tell what became of it."""
    from conveyor.errors import InputError

    if ledger is not None:
        from aggregator.ledger.at_rest import order_at_rest
        from aggregator.ledger.reader import ledger_file

        answer = order_at_rest(ledger_file(ledger), order)
    else:
        from conveyor.load_orders import check_order, give_order

        link, name = address.link()
        check_order(order)
        link = link.model_copy(update={"connect_timeout_s": asking.wait_s})
        order = replace(order, age_s=_since_typed_s())
        with _told_while_waiting(link.router, asking.wait_s):
            answer = give_order(link, name, order, within_s=asking.wait_s)
    if asking.json:
        sys.stdout.write(json_module.dumps(asdict(answer)) + "\n")
    if not answer.done:
        raise InputError(answer.error)
    if not asking.json:
        where = "" if answer.place_x_m is None else f" at {answer.place_x_m:.2f} m of the belt"
        sys.stdout.write(f"{answer.text}{where}\n")
