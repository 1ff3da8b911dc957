"""From an order about a load to the event that the ledger is to keep, or the reason in words why it cannot be."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from aggregator.core.loads import NO_LOAD, Load, LoadBook, LoadEvent, Said, ticket_told
from conveyor.errors import InputError
from conveyor.messages.loads import NUMBER, LoadAnswer, LoadOrder, number_meant
from conveyor.stated import TICKET_KG

UNDO_WITHIN_S = 60.0
LAST = "last"
SCALE_ERROR = 0.005
"""Of a ticket, where the scale's error is not told."""
NAMED_IN_ERRORS = 8
MOST_TEXT = 4000
"""Characters of an answer."""


def decide(
    order: LoadOrder,
    book: LoadBook,
    *,
    run: str,
    now_ns: int,
    line: Mapping[str, float],
    place_x_m: Callable[[LoadOrder], float],
    ago_s: Callable[[LoadEvent], float | None] = lambda event: None,
) -> LoadEvent:
    """The event that `order` comes to; the one it came to before, where it was carried out already.

    An id stands for one order: who asks, how long ago and where on the belt may differ from try to try.

    Args:
        now_ns: wall clock of the aggregator's machine; line: what a load keeps of the line as
            it is, 'utc_offset_s' and 'stated_offset_mm'.
        place_x_m: where on the belt an order that changes loads does so; may raise InputError.
        ago_s: how long ago an event was said by a clock that no one sets; None where the wall clock has to tell.

    Raises:
        InputError: it cannot be carried out; the text says why, and what can. Or its id is another order's.
    """
    if (known := book.events.get(order.request)) is not None:
        if not _asked_before(order, known, book):
            raise InputError(
                f"order {order.request} was carried out already, with other content ({_told(known, book)}); this one "
                "is not carried out: send it under an id of its own (--request, or none for a new one)"
            )
        return known
    decisions: dict[str, Callable[[], tuple[Said, int, float | None, Mapping[str, Any]]]] = {
        "start": lambda: _start(order, book, run, line, place_x_m),
        "end": lambda: _end(order, book, run, place_x_m),
        "note": lambda: _note(order, book, run),
        "ticket": lambda: _ticket(order, book, run),
        "undo": lambda: _undo(book, run, now_ns, ago_s),
    }
    kind, load, place, payload = decisions[order.action]()
    return LoadEvent(book.last_n + 1, run, order.request, kind, load, place, now_ns, order.by, payload)


def _asked_before(order: LoadOrder, event: LoadEvent, book: LoadBook) -> bool:
    """Whether `order` comes to `event` by all that had been said before it."""
    before = LoadBook.of(each for each in book.events.values() if each.n < event.n)
    try:
        found = decide(
            order,
            before,
            run=event.run,
            now_ns=event.said_ns,
            line={},
            place_x_m=lambda _: 0.0,
            ago_s=lambda _: 0.0,  # it was in time
        )
    except InputError:
        return False
    same = all(event.payload.get(name) == value for name, value in found.payload.items())
    return same and (found.kind, found.load) == (event.kind, event.load)


def answer(order: LoadOrder, event: LoadEvent, book: LoadBook, *, remark: str = "") -> LoadAnswer:
    """What is told of an order that was carried out. `remark`: what is to be said of the ticket that was entered."""
    load = book.loads[event.load]
    place = event.place_x_m
    finite = place if place is not None and abs(place) < 1e7 else None
    return LoadAnswer(
        order.request,
        True,
        text="; ".join(filter(None, (_told(event, book), remark)))[:MOST_TEXT],
        load=load.number,
        name=load.name,
        event=event.n,
        place_x_m=finite,
    )


def refusal(order: LoadOrder, error: Exception, *, later: bool = False) -> LoadAnswer:
    """What is told of an order that was not."""
    return LoadAnswer(order.request, False, error=str(error)[:MOST_TEXT], later=later)


def _told(event: LoadEvent, book: LoadBook) -> str:
    if event.load not in book.loads:
        return "what it did was lost to damage"
    load = book.loads[event.load]
    if event.kind is Said.TICKET:
        ticket = event.payload
        kind = "net" if ticket["net"] else "gross"
        if ticket["ticket_g"] is None:
            return f"the {kind} ticket of {load.told} is withdrawn"
        return f"{load.told}: {ticket_told(ticket['ticket_g'])} {kind} on the scale"
    if event.kind is Said.UNDO:
        open_load = book.open_load(event.run)
        now_open = "no load" if open_load is None else open_load.told
        return f"the {undone_kind(event, book)} of {load.told} is undone: {now_open} is open"
    words = {Said.START: "has begun", Said.RESUME: "goes on", Said.END: "has ended", Said.NOTE: "is noted"}
    end = f" {event.where}" if event.place_x_m == -math.inf else ""  # other places are told as numbers
    return f"{load.told} {words[event.kind]}{end}"


def undone_kind(undo: LoadEvent, book: LoadBook) -> Said | str:
    """What was taken back: 'start', 'resume' or 'end'."""
    undone = undo.payload.get("event")
    return next((event.kind for event in book.events.values() if event.n == undone), "last change")


def find(book: LoadBook, wanted: str, run: str) -> Load:
    """The load meant by a number, 'number:' and a number, or a name; '' is the open one, or the last one that was.

    Raises:
        InputError: none, several of that name, or a number that another load has as its name; the text lists some.
    """
    there = [load for load in book.loads.values() if not load.undone]
    numbered = [load for load in there if load.number == number_meant(wanted)]
    named = [load for load in there if load.name == wanted]
    if not wanted or wanted == LAST:
        if not wanted and (load := book.open_load(run)) is not None:
            return load
        if not there:
            raise InputError("this ledger has no load yet: start one with `tuberline load start NAME`")
        numbered = [max(there, key=lambda load: load.number)]
    others = [load for load in named if load not in numbered]
    if wanted and numbered and others and not wanted.startswith(NUMBER):
        raise InputError(_two_meanings(wanted, numbered[0], others[-NAMED_IN_ERRORS:]))
    found = numbered or named
    if len(found) == 1:
        return found[0]
    told = ", ".join(load.told for load in (found or there)[-NAMED_IN_ERRORS:])
    if found:
        raise InputError(f"{len(found)} loads are named {wanted!r}: give the number; they are {told}")
    raise InputError(f"no load {wanted!r}; {f'the last ones are {told}' if told else 'this ledger has none yet'}")


def _two_meanings(wanted: str, meant: Load, others: list[Load]) -> str:
    what = f"the newest load, {meant.told}," if wanted == LAST else f"the number of {meant.told}"
    told = ", ".join(load.told for load in others)
    ways = " or ".join(f"{NUMBER}{load.number}" for load in (meant, *others))
    return f"{wanted!r} is {what} and the name of {told}: give {ways}"


def _start(
    order: LoadOrder, book: LoadBook, run: str, line: Mapping[str, float], place_x_m: Callable[[LoadOrder], float]
) -> tuple[Said, int, float | None, dict[str, Any]]:
    payload: dict[str, Any] = {"fields": dict(order.fields), "note": order.note, **line}
    if not order.load:
        return Said.START, max(book.loads, default=NO_LOAD) + 1, place_x_m(order), payload
    load = find(book, order.load, run)
    if book.open_load(run) is load:
        raise InputError(f"{load.told} is open already")
    return Said.RESUME, load.number, place_x_m(order), {**payload, "was_ended_ns": load.ended_ns}


def _end(
    order: LoadOrder, book: LoadBook, run: str, place_x_m: Callable[[LoadOrder], float]
) -> tuple[Said, int, float | None, dict[str, Any]]:
    load = book.open_load(run)
    if load is None:
        raise InputError("no load is open: nothing to end; `tuberline load show` lists those of this ledger")
    if order.load and find(book, order.load, run) is not load:
        raise InputError(f"{find(book, order.load, run).told} is not open; {load.told} is")
    return Said.END, load.number, place_x_m(order), {"note": order.note}


def _note(order: LoadOrder, book: LoadBook, run: str) -> tuple[Said, int, None, dict[str, Any]]:
    if not order.note and not order.fields:
        raise InputError("a note needs a text, or a field to correct: --variety, --field, ...")
    return Said.NOTE, find(book, order.load, run).number, None, {"fields": dict(order.fields), "note": order.note}


def _ticket(order: LoadOrder, book: LoadBook, run: str) -> tuple[Said, int, None, dict[str, Any]]:
    load = find(book, order.load, run)
    if order.kg is None:
        if load.ticket(net=order.net) is None:
            raise InputError(f"{load.told} has no {'net' if order.net else 'gross'} ticket to withdraw")
        return Said.TICKET, load.number, None, {"ticket_g": None, "sd_g": 0.0, "net": order.net, "note": order.note}
    least_kg, most_kg = TICKET_KG
    if not least_kg <= order.kg <= most_kg:
        raise InputError(
            f"a ticket of {order.kg:g} kg: give what the scale said of the load, from {least_kg:g} kg up to "
            f"{most_kg:g} kg"
        )
    sd_kg = SCALE_ERROR * order.kg if order.scale_error_kg is None else order.scale_error_kg
    said = {"ticket_g": 1000 * order.kg, "sd_g": 1000 * sd_kg, "net": order.net, "note": order.note}
    return Said.TICKET, load.number, None, said


def _undo(
    book: LoadBook, run: str, now_ns: int, ago_s: Callable[[LoadEvent], float | None]
) -> tuple[Said, int, None, dict[str, Any]]:
    change = book.last_change(run)
    if change is None:
        raise InputError("nothing to undo: no load was started or ended in this run")
    steady_s = ago_s(change)
    passed_s = (now_ns - change.said_ns) / 1e9 if steady_s is None else steady_s
    if passed_s < -UNDO_WITHIN_S:
        raise InputError(
            f"the clock of the aggregator's machine was set back by at least {-passed_s:.0f} s since the last change "
            f"({change.kind} of {book.loads[change.load].told}), so it is not known how long ago that was; start or "
            "end the load again"
        )
    if passed_s > UNDO_WITHIN_S:
        raise InputError(
            f"the last change ({change.kind} of {book.loads[change.load].told}) was {passed_s:.0f} s ago, a change can "
            f"be undone within {UNDO_WITHIN_S:.0f} s; start or end the load again"
        )
    return Said.UNDO, change.load, None, {"event": change.n}
