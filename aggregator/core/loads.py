"""Loads as the ledger tells of them: what was said in order, and the loads and stretches of belt that follow from it.

A load begins and ends at a place on the belt, so a tuber belongs to exactly one, whenever and by whatever camera it
comes. Places fall as the belt runs: a stretch (`Span`) reaches from its own place down to that of the next one. Nothing
that was said is ever changed: an undo, a correction or another ticket is one more event. Pure: events in, loads out.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

from conveyor.messages.loads import FIELDS

NO_LOAD = 0
"""Number of what passes while no load is open."""
SAME_OFFSET_MM = 0.05
"""Stated resting offsets that lie nearer to one another are one and the same."""


class Said(StrEnum):
    """What an event says."""

    START = "start"
    RESUME = "resume"
    """A load that had ended goes on."""
    END = "end"
    NOTE = "note"
    TICKET = "ticket"
    UNDO = "undo"
    LOST = "lost"
    """A repair filled the place of an event that was damaged."""


@dataclass(frozen=True, slots=True)
class LoadEvent:
    """One thing said of a load.

    Attributes:
        n: 1, 2, 3, ... in its ledger. run: in which it was said. request: id of the order, unique.
        load: number of the load it is about. place_x_m: where on the belt it changes, infinite at a run's beginning,
            minus infinity where all belt of the run comes before it; None where it changes nothing there.
        said_ns: by the clock of the aggregator's machine. said_by: as the asker said it.
        payload: 'fields', 'note', 'ticket_g', 'sd_g', 'net', 'utc_offset_s', 'stated_offset_mm', 'event', by kind.
    """

    n: int
    run: str
    request: str
    kind: Said
    load: int
    place_x_m: float | None
    said_ns: int
    said_by: str
    payload: Mapping[str, Any]

    @property
    def where(self) -> str:
        """Where on the belt, in words; '' where it changes nothing there."""
        if self.place_x_m is None:
            return ""
        if math.isinf(self.place_x_m):
            return "at the beginning of the run" if self.place_x_m > 0 else "at the end of the belt"
        return f"at {self.place_x_m:.3f} m"


@dataclass(frozen=True, slots=True)
class Span:
    """A stretch of a run's belt, from `from_x_m` on down to the next one's; `n`: the event that began it, or 0."""

    n: int
    load: int
    from_x_m: float


@dataclass(frozen=True, slots=True)
class Note:
    """What somebody remarked, and the fields that were corrected with it."""

    n: int
    said_ns: int
    said_by: str
    text: str
    fields: Mapping[str, str]


def ticket_told(grams: float) -> str:
    """What a scale said, to the gram: '8123.0 kg', '1.31 kg'."""
    whole, _, part = f"{grams / 1000:.3f}".partition(".")
    return f"{whole}.{part[0]}{part[1:].rstrip('0')} kg"


@dataclass(frozen=True, slots=True)
class LoadTicket:
    """What a scale said of a load, grams; `ticket_g` None: the one before was withdrawn. `net`: tubers alone, else with
    soil and stones."""

    n: int
    said_ns: int
    said_by: str
    ticket_g: float | None
    sd_g: float
    net: bool


@dataclass(frozen=True, slots=True)
class Load:
    """A load by all that was said of it.

    Attributes:
        began_ns, ended_ns: wall clock; `ended_ns` is None while it is open. utc_offset_s: of the line's clock.
        stated_offset_mm: resting offset that the line stated when it began. resumed_at_mm: (stretch of
            belt, that offset) where it went on.
        spans: (run, span) of its stretches of belt; several where it went on after an end.
        notes, tickets: all, oldest first. undone: its start was undone; it holds no belt.
    """

    number: int
    run: str
    began_ns: int
    began_by: str
    utc_offset_s: int = 0
    stated_offset_mm: float = 0.0
    resumed_at_mm: tuple[tuple[int, float], ...] = ()
    ended_ns: int | None = None
    name: str = ""
    trailer: str = ""
    field: str = ""
    variety: str = ""
    customer: str = ""
    operator: str = ""
    spans: tuple[tuple[str, int], ...] = ()
    notes: tuple[Note, ...] = ()
    tickets: tuple[LoadTicket, ...] = ()
    undone: bool = False

    @property
    def told(self) -> str:
        """Number and name, for a person."""
        return f"load {self.number}{f' ({self.name})' if self.name else ''}"

    def ticket(self, *, net: bool) -> LoadTicket | None:
        """The ticket that counts: the last one of its kind, unless that withdrew it."""
        last = next((ticket for ticket in reversed(self.tickets) if ticket.net == net), None)
        return last if last is not None and last.ticket_g is not None else None


def span_of(spans: Sequence[Span], place_x_m: float) -> Span:
    """The stretch that holds a place; `spans` in order along the belt, the first from the run's beginning."""
    return spans[max(0, bisect_left(spans, -place_x_m, key=lambda span: -span.from_x_m) - 1)]


@dataclass(slots=True)
class LoadBook:
    """Everything said so far, and what follows from it. `spans` are by run, and of runs in which a load changed."""

    loads: dict[int, Load] = field(default_factory=dict)
    spans: dict[str, list[Span]] = field(default_factory=dict)
    events: dict[str, LoadEvent] = field(default_factory=dict)
    """By request."""
    last_n: int = 0
    closed: dict[int, int] = field(default_factory=dict)
    """Number of the load that was open and ended, by number of the event that ended it: an end, or another's start."""
    undone: set[int] = field(default_factory=set)
    """Numbers of the changes that were taken back."""

    @classmethod
    def of(cls, events: Iterable[LoadEvent]) -> LoadBook:
        """The book of all events of a ledger, in order."""
        book = cls()
        for event in events:
            book.apply(event)
        return book

    def open_load(self, run: str) -> Load | None:
        """The load that is open in `run`."""
        spans = self.spans.get(run)
        return self.loads.get(spans[-1].load) if spans else None

    def last_change(self, run: str) -> LoadEvent | None:
        """The event that began the last stretch of `run`; None where nothing changed, or all of it was undone."""
        spans = self.spans.get(run)
        return next((e for e in reversed(self.events.values()) if spans and e.n == spans[-1].n), None)

    def apply(self, event: LoadEvent) -> None:
        """Take the next event."""
        self.events[event.request] = event
        self.last_n = event.n
        follows: dict[Said, Callable[[LoadEvent], None]] = {
            Said.START: self._start,
            Said.RESUME: self._resume,
            Said.END: self._end,
            Said.NOTE: self._note,
            Said.TICKET: self._ticket,
            Said.UNDO: self._undo,
        }
        if event.kind in follows:
            follows[event.kind](event)

    def _start(self, event: LoadEvent) -> None:
        self._close_open(event)
        self.loads[event.load] = Load(
            event.load,
            event.run,
            event.said_ns,
            event.said_by,
            utc_offset_s=int(event.payload.get("utc_offset_s", 0)),
            stated_offset_mm=float(event.payload.get("stated_offset_mm", 0.0)),
            spans=((event.run, event.n),),
            notes=_notes(event),
            **_fields(event),
        )
        self._begin_span(event, event.load)

    def _known(self, event: LoadEvent) -> Load:
        """The load of an event; where the event that began it was lost to damage, one without any description."""
        return self.loads.get(event.load) or Load(event.load, event.run, event.said_ns, event.said_by)

    def _resume(self, event: LoadEvent) -> None:
        self._close_open(event)
        load = self._known(event)
        spans, notes = (*load.spans, (event.run, event.n)), (*load.notes, *_notes(event))
        stated_mm = float(event.payload.get("stated_offset_mm", load.stated_offset_mm))
        at_mm = (*load.resumed_at_mm, (event.n, stated_mm))
        self.loads[event.load] = replace(
            load, ended_ns=None, spans=spans, notes=notes, resumed_at_mm=at_mm, **_fields(event)
        )
        self._begin_span(event, event.load)

    def _end(self, event: LoadEvent) -> None:
        self._close_open(event)
        self._note(event)
        self._begin_span(event, NO_LOAD)

    def _close_open(self, event: LoadEvent) -> None:
        if (open_load := self.open_load(event.run)) is not None:
            self.loads[open_load.number] = replace(open_load, ended_ns=event.said_ns)
            self.closed[event.n] = open_load.number

    def _begin_span(self, event: LoadEvent, load: int) -> None:
        spans = self.spans.setdefault(event.run, [Span(0, NO_LOAD, math.inf)])
        spans.append(Span(event.n, load, math.inf if event.place_x_m is None else event.place_x_m))

    def _note(self, event: LoadEvent) -> None:
        load = self._known(event)
        self.loads[event.load] = replace(load, notes=(*load.notes, *_notes(event)), **_fields(event))

    def _ticket(self, event: LoadEvent) -> None:
        load, said = self._known(event), event.payload
        ticket = LoadTicket(event.n, event.said_ns, event.said_by, said["ticket_g"], said["sd_g"], bool(said["net"]))
        self.loads[event.load] = replace(load, tickets=(*load.tickets, ticket), notes=(*load.notes, *_notes(event)))

    def _undo(self, event: LoadEvent) -> None:
        """The last stretch of the run goes back to the one before it, and both their loads are what they would be if
        the change had never been said; what was said of them since stays."""
        undone = self.last_change(event.run)
        if undone is None or undone.n != event.payload.get("event"):
            return  # what it undid was lost to damage
        self.undone.add(undone.n)
        gone = self.spans[event.run].pop()
        if undone.load in self.loads:
            self.loads[undone.load] = self._without(undone)
        if gone.load != NO_LOAD:
            ended = undone.payload.get("was_ended_ns") if undone.kind is Said.RESUME else event.said_ns
            started = undone.kind is Said.START
            self.loads[gone.load] = replace(self._known(undone), ended_ns=ended, undone=started)
        if (again := self.open_load(event.run)) is not None:
            self.loads[again.number] = replace(again, ended_ns=None)

    def _without(self, undone: LoadEvent) -> Load:
        """The load of a change without what that said of it; one that it began stays described."""
        load = self.loads[undone.load]
        fields: dict[str, Any] = dict.fromkeys(FIELDS, "")
        for event in self.events.values():
            if event.load == load.number and (event.kind is Said.START or event.n not in self.undone):
                fields |= _fields(event)
        return replace(
            load,
            spans=tuple(span for span in load.spans if span != (undone.run, undone.n)),
            resumed_at_mm=tuple(at for at in load.resumed_at_mm if at[0] != undone.n),
            notes=tuple(note for note in load.notes if note.n != undone.n or undone.kind is Said.START),
            **fields,
        )


def _fields(event: LoadEvent) -> dict[str, Any]:
    return {name: str(text) for name, text in event.payload.get("fields", {}).items() if name in FIELDS}


def _notes(event: LoadEvent) -> tuple[Note, ...]:
    text, fields = str(event.payload.get("note", "")), _fields(event)
    if not text and not (fields and event.kind in (Said.NOTE, Said.RESUME)):
        return ()
    return (Note(event.n, event.said_ns, event.said_by, text, fields if event.kind is not Said.START else {}),)
