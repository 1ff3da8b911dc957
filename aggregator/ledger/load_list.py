"""The loads of a ledger as plain values: for commands, for who asks over the link, for the page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from aggregator.calibration.leave_one_out import contradicting_all
from aggregator.calibration.load_tickets import load_ticket
from aggregator.core.foreign_totals import jacket_g
from aggregator.core.load_orders import undone_kind
from aggregator.core.load_told import load_now
from aggregator.core.loads import Load, LoadBook, LoadEvent, LoadTicket, Said, ticket_told
from aggregator.ledger.earlier_loads import heights_before
from aggregator.ledger.line_tickets import tickets_beside
from aggregator.ledger.load_totals import ReadLoads, Seen, count_load
from aggregator.ledger.ticket_doubts import load_doubts
from aggregator.ledger.verified import LedgerView
from conveyor.contract import Contract
from conveyor.errors import InputError
from conveyor.messages.base import plain
from conveyor.messages.loads import is_meant


def told_loads(
    view: LedgerView, *, limit: int, contract: Contract | None = None, wanted: str = ""
) -> list[dict[str, Any]]:
    """The newest loads first, calibrated by the tickets of this ledger's loads and of the config beside it.

    `wanted`: a number, 'number:' and a number, or a name; of those alone that it may mean.
    Names and units as in `conveyor.messages.LoadNow`; besides `open`, `ended_unix_s`, `net_g` and `gross_g` (what
    scales said), `said` (all that was said of it), `notes` (texts of persons, oldest first), `refused` (why its ticket
    does not calibrate), `doubts` (what speaks against its tickets), `remarks` (which of its runs were cut off or
    repaired with losses) and `jacket_g` (gross less net less foreign matter: soil on tubers).
    """
    ledger = ReadLoads(view)
    seen = ledger.seen
    tickets = tickets_beside(ledger)
    contradictions = contradicting_all(tickets)
    chosen = [load for load in ledger.loads.loads.values() if not load.undone]
    if wanted:
        chosen = [load for load in chosen if is_meant(wanted, number=load.number, name=load.name)]
    newest = sorted(chosen, key=lambda load: load.number, reverse=True)[:limit]
    return [
        _told(ledger, load, seen, tickets, contract) | {"doubts": load_doubts(load, contradictions)} for load in newest
    ]


def _told(
    ledger: ReadLoads, load: Load, seen: Mapping[str, Seen], tickets: list[Any], contract: Contract | None
) -> dict[str, Any]:
    found = count_load(ledger, load, seen)
    refused = []
    try:
        load_ticket(load, found, cultivar=ledger.stated.cultivar)
    except InputError as error:
        refused.append(str(error))
    net, gross = load.ticket(net=True), load.ticket(net=False)
    now = load_now(
        load,
        found,
        tickets,
        prior=ledger.prior(load.run),
        cultivar=ledger.stated.cultivar,
        contract=contract,
        densities=ledger.stated.densities,
        earlier=heights_before(ledger, load, cultivar=ledger.stated.cultivar),
    )
    values: dict[str, Any] = plain(now)
    return {
        **values,
        "run": load.run,
        "began_unix_s": load.began_ns / 1e9,
        "ended_unix_s": None if load.ended_ns is None else load.ended_ns / 1e9,
        "open": found.open,
        "undone": load.undone,
        "net_g": None if net is None else net.ticket_g,
        "gross_g": None if gross is None else gross.ticket_g,
        "jacket_g": jacket_g(_grams(gross), _grams(net), now.foreign),
        "refused": refused,
        "remarks": list(ledger.remarks(run for run, _ in load.spans)),
        "said": _said(ledger.loads, load),
        "notes": [{"by": note.said_by, "text": note.text} for note in load.notes if note.text],
    }


def _grams(ticket: LoadTicket | None) -> float | None:
    return None if ticket is None else ticket.ticket_g


def _said(book: LoadBook, load: Load) -> list[dict[str, Any]]:
    """All that was said of a load, oldest first: who, when, what; that its end or another change was undone, too. Also
    what another load did to it: one that starts or goes on ends the open one.
    """
    told = []
    for event in book.events.values():
        texts = _texts(book, event) if event.load == load.number else _of_other(book, event, load)
        told += [{"unix_s": event.said_ns / 1e9, "by": event.said_by, "text": text} for text in texts]
    return told


def _texts(book: LoadBook, event: LoadEvent) -> list[str]:
    """What an event said, in words: what it did, and what was noted with it."""
    if event.kind is Said.TICKET:
        kind, grams = "net" if event.payload["net"] else "gross", event.payload["ticket_g"]
        did = f"{kind} ticket withdrawn" if grams is None else f"{kind} ticket {ticket_told(grams)}"
    elif event.kind is Said.UNDO:
        did = f"the {undone_kind(event, book)} is undone"
    else:
        did = {Said.START: "began", Said.RESUME: "went on", Said.END: "ended"}.get(event.kind, "")
    fields = {} if event.kind is Said.START else event.payload.get("fields", {})
    noted = [event.payload.get("note", ""), ", ".join(f"{name} is {text}" for name, text in fields.items())]
    return [text for text in (did, "; ".join(filter(None, noted))) if text]


def _of_other(book: LoadBook, event: LoadEvent, load: Load) -> list[str]:
    """What an event of another load did to `load`, in words: it ended it, or such an end was undone."""
    if event.kind is Said.UNDO:
        undone = event.payload.get("event")
        return ["the end is undone"] if undone in book.undone and book.closed.get(undone) == load.number else []
    if book.closed.get(event.n) != load.number:
        return []
    did = "went on" if event.kind is Said.RESUME else "began"
    return [f"ended, for {book.loads[event.load].told} {did}"]
