"""Events of loads and sums of stretches of belt as rows of the ledger, and back."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Self

from aggregator.core.coverage import Coverage
from aggregator.core.foreign import ForeignBody
from aggregator.core.load_sums import LoadSums
from aggregator.core.loads import LoadBook, LoadEvent, Said, Span, span_of
from aggregator.core.reasons import Unseen
from aggregator.ledger.schema import LOAD_EVENT, LOAD_TOTAL, row
from aggregator.ledger.verified import LedgerView
from conveyor.messages import Tuber


@dataclass(slots=True)
class SpanSums:
    """What the tubers of a stretch come to, and how much of its belt was seen, once that is settled."""

    load: LoadSums
    seen: Coverage | None = None

    def text(self) -> str:
        """As the ledger keeps it."""
        seen = None if self.seen is None else asdict(self.seen)
        return json.dumps({"load": self.load.plain(), "seen": seen}, sort_keys=True, separators=(",", ":"))

    @classmethod
    def from_text(cls, text: str) -> Self:
        """Back from `text`."""
        values = json.loads(text)
        seen = values["seen"]
        if seen is not None:
            unseen = {name: {Unseen(why): m for why, m in own.items()} for name, own in seen.pop("unseen_m").items()}
            seen = Coverage(**seen, unseen_m=unseen)
        return cls(LoadSums.from_plain(values["load"]), seen)


def event_row(event: LoadEvent) -> tuple[Any, ...]:
    """Row of table `load_event`."""
    place = None if event.place_x_m is None else float(event.place_x_m)
    said = json.dumps(event.payload, sort_keys=True, separators=(",", ":"))
    return row(
        (event.n, event.run, event.request, event.kind.value, event.load, place, event.said_ns, event.said_by, said)
    )


def event_from(columns: Sequence[Any]) -> LoadEvent:
    """The event of a row (columns in the table's order, `crc` left out)."""
    n, run, request, kind, load, place_x_m, said_ns, said_by, payload = columns
    return LoadEvent(n, run, request, Said(kind), load, place_x_m, said_ns, said_by, json.loads(payload))


def read_events(view: LedgerView) -> Iterator[LoadEvent]:
    """All that was said of loads, in order; nothing in a ledger of an older version."""
    return map(event_from, view.rows(LOAD_EVENT, "ORDER BY n"))


def read_book(view: LedgerView) -> LoadBook:
    """All loads of a ledger."""
    return LoadBook.of(read_events(view))


def read_span_sums(view: LedgerView, run: str) -> dict[int, SpanSums]:
    """The sums of each stretch of a run; empty where no load changed in it."""
    found = view.rows(LOAD_TOTAL, "WHERE run = ? ORDER BY span", (run,))
    return {span: SpanSums.from_text(payload) for _run, span, _step, payload in found}


def add_tubers(sums: dict[int, SpanSums], spans: Sequence[Span], tubers: Sequence[Tuber | ForeignBody]) -> set[int]:
    """Add each tuber to the stretch that holds its place; returns the stretches that changed."""
    changed = set()
    for tuber in tubers:
        span = span_of(spans, tuber.place_x_m)
        sums[span.n].load.add(tuber)
        changed.add(span.n)
    return changed
