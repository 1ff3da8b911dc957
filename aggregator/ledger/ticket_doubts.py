"""What speaks against the tickets of a ledger's loads, in words. Those of which others say something else count for
little; none is thrown away, for scales are corrected later.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

from aggregator.calibration.leave_one_out import LeftOut, contradicting, contradicting_all
from aggregator.calibration.load_tickets import load_ticket
from aggregator.calibration.tickets import Ticket
from aggregator.core.loads import Load, LoadEvent, Said, ticket_told
from aggregator.ledger.load_totals import Seen, Sums, count_load
from conveyor.errors import InputError

MOST_TOLD = 6
"""Tickets that an answer names: it is read at once, and `tuberline ledger totals` has all of them."""


def gross_below_net(load: Load) -> list[str]:
    """That the gross ticket of a load is below its net one; empty where it is not."""
    net, gross = load.ticket(net=True), load.ticket(net=False)
    if net is None or gross is None or net.ticket_g is None or gross.ticket_g is None:
        return []
    if gross.ticket_g >= net.ticket_g:
        return []
    return [
        f"the gross ticket of {load.told}, {ticket_told(gross.ticket_g)}, is below its net one, "
        f"{ticket_told(net.ticket_g)}: one of the two is wrong, for gross is net and what soil and stones weigh"
    ]


def load_doubts(load: Load, contradictions: Sequence[LeftOut]) -> list[str]:
    """What speaks against the tickets of one load; `contradictions`: of all tickets that calibrate its ledger."""
    own = [entry.told for entry in contradictions if entry.ticket.key == _key(load)]
    return [*own, *gross_below_net(load)]


def ledger_doubts(loads: Iterable[Load], tickets: Sequence[Ticket], asked: Callable[[Ticket], bool]) -> list[str]:
    """What speaks against those of `tickets`, which calibrate a ledger, that are `asked` for, and against the gross
    ones of `loads` of it.
    """
    found = [entry.told for entry in contradicting_all(tickets) if asked(entry.ticket)]
    return [*found, *(words for load in loads for words in gross_below_net(load))]


def of_other_weights(tickets: Sequence[Ticket], models: Iterable[str]) -> list[str]:
    """That `tickets` are of other weights than some of `models`, which weighed what they should calibrate; empty where
    no ticket is in use.
    """
    known = {ticket.model for ticket in tickets if not ticket.set_aside}
    bare = sorted(set(models) - known)
    if not known or not bare:
        return []
    return [
        f"no ticket calibrates what {', '.join(bare)} weighed: those at hand are of {', '.join(sorted(known))}. "
        "Weights that changed are calibrated again, by a bucket or a load"
    ]


def ticket_remark(
    ledger: Sums,
    event: LoadEvent,
    seen: Mapping[str, Seen],
    tickets: Callable[[], Sequence[Ticket]],
    *,
    cultivar: str = "",
) -> str:
    """What is to be said of the ticket that was just entered, in words; '' where nothing is, or none was entered.

    Args:
        seen: what the cameras looked at, of all runs that the load has belt in.
        tickets: all that calibrate the ledger, with this one.
        cultivar: where the load names no variety.
    """
    if event.kind is not Said.TICKET or event.payload["ticket_g"] is None:
        return ""
    load = ledger.loads.loads[event.load]
    doubts = gross_below_net(load)
    if event.payload["net"]:
        try:
            ticket = load_ticket(load, count_load(ledger, load, seen), cultivar=cultivar)
        except InputError as error:
            return "; ".join((f"it is kept, but does not calibrate: {error}", *doubts))
        if ticket is not None:
            found = contradicting(tickets(), ticket.model, stated_offset_mm=ticket.stated_offset_mm)
            found.sort(key=lambda entry: (entry.ticket.key != ticket.key, -abs(entry.z)))
            more = [f"{len(found) - MOST_TOLD} more contradict"] if len(found) > MOST_TOLD else []
            doubts = [*(entry.told for entry in found[:MOST_TOLD]), *more, *doubts]
    return "; ".join(doubts)


def _key(load: Load) -> tuple[str, str, str]:
    """Of a load's own ticket among all (`aggregator.calibration.load_tickets`)."""
    return "load", load.run, f"load {load.number}"
