"""The writer's part for loads: events of loads, and the sums of stretches of belt, within its transactions."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterable, Sequence

from aggregator.core.coverage import Moment, all_reach, belt_window
from aggregator.core.foreign import ForeignBody
from aggregator.core.load_sums import LoadSums
from aggregator.core.load_told import span_coverage
from aggregator.core.loads import LoadBook, LoadEvent, Said, Span
from aggregator.ledger.load_rows import SpanSums, add_tubers, event_row, read_book, read_span_sums
from aggregator.ledger.schema import LOAD_EVENT
from aggregator.ledger.steps import span_step
from aggregator.ledger.sums import RunSums
from aggregator.ledger.verified import LedgerView
from conveyor.messages import Tuber


class LoadKeeper:
    """What a ledger says of loads, kept up to date with each transaction; `forget` it where one fails."""

    def __init__(self, db: sqlite3.Connection, view: Callable[[], LedgerView], step: Callable[[str], None]) -> None:
        self._db = db
        self._view = view
        self._step = step
        self._book: LoadBook | None = None
        self._sums: dict[str, dict[int, SpanSums]] = {}

    def forget(self) -> None:
        """They may hold what was not written: the next one reads them again."""
        self._book = None
        self._sums.clear()

    @property
    def book(self) -> LoadBook:
        """All loads as committed."""
        if self._book is None:
            self._book = read_book(self._view())
        return self._book

    def sums(self, run: str) -> dict[int, SpanSums]:
        """The sums of each stretch of `run` as committed; empty where no load changed in it."""
        if run not in self._sums:
            self._sums[run] = read_span_sums(self._view(), run)
        return self._sums[run]

    def count(self, run: str, tubers: Sequence[Tuber | ForeignBody]) -> None:
        """Tubers of a batch, and what is none: each goes to the stretch that holds its place."""
        spans = self.book.spans.get(run)
        if spans and tubers:
            self._write(run, add_tubers(self.sums(run), spans, tubers))

    def count_again(
        self, run: str, tubers: Callable[[], Iterable[Tuber | ForeignBody]], histogram_step_g: float
    ) -> None:
        """All tubers of a run, in classes of another width."""
        sums, spans = self.sums(run), self.book.spans.get(run)
        for mine in sums.values():
            mine.load = LoadSums(histogram_step_g)
        if spans:
            for tuber in tubers():
                add_tubers(sums, spans, [tuber])
        self._write(run, set(sums))

    def say(self, event: LoadEvent, run_sums: RunSums) -> None:
        """One more event; what it changes of the stretches is written with it."""
        written = event_row(event)
        self._db.execute(LOAD_EVENT.insert, written)
        run_sums.add_rows(LOAD_EVENT, [written])
        self._step("load_event written")
        before = list(self.book.spans.get(event.run, ()))
        self.book.apply(event)
        after = self.book.spans.get(event.run, [])
        if event.kind is Said.UNDO and len(after) < len(before):
            self._join(event.run, before)
        elif len(after) > len(before):
            self._divide(event.run, after, run_sums)

    def settle(self, run: str, run_sums: RunSums) -> None:
        """The run is over: what was seen of its last stretches changes no more."""
        spans = self.book.spans.get(run, [])
        self._write(run, {span.n for at, span in enumerate(spans) if self._seen(run, spans, at, run_sums)})

    def _divide(self, run: str, spans: Sequence[Span], run_sums: RunSums) -> None:
        """A new stretch has begun; the first one has all that was counted before."""
        sums, new = self.sums(run), {spans[-1].n}
        if not sums:
            sums[spans[0].n] = SpanSums(run_sums.load.copy())
            new.add(spans[0].n)
        sums[spans[-1].n] = SpanSums(LoadSums(run_sums.load.histogram_step_g))
        # Two changes back is known for good where all cameras have passed it: a run's many gaps are told apart only so
        # far back (`aggregator.core.sight`), so it is worked out now.
        for at, span in enumerate(spans[:-2]):
            _, end_m = belt_window(run_sums.sights, span.from_x_m, spans[at + 1].from_x_m)
            if all_reach(run_sums.sights, end_m) and self._seen(run, spans, at, run_sums):
                new.add(span.n)
        self._write(run, new)

    def _seen(self, run: str, spans: Sequence[Span], at: int, run_sums: RunSums) -> bool:
        """Work out what was seen of a stretch's belt, if that is not known; whether it was worked out."""
        mine = self.sums(run)[spans[at].n]
        if mine.seen is not None:
            return False
        mine.seen = span_coverage(spans, at, mine.load, run_sums.sights, Moment(over=True))
        return True

    def _join(self, run: str, before: Sequence[Span]) -> None:
        """The last stretch goes back to the one before it."""
        sums, last, gone = self.sums(run), before[-2].n, before[-1].n
        sums[last].load.take(sums[gone].load)
        sums[last].seen = None
        sums[gone] = SpanSums(LoadSums(sums[last].load.histogram_step_g))
        self._write(run, {last, gone})

    def _write(self, run: str, spans: set[int]) -> None:
        for span in sorted(spans):
            span_step(self._db, run, span, self.sums(run)[span])
        if spans:
            self._step("sums of loads written")
