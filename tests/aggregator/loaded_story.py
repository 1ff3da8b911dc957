"""A story during which loads change, and what each comes to by rows and by sums."""

from __future__ import annotations

from pathlib import Path

import pytest

from aggregator.core.load_orders import answer, decide
from aggregator.core.loads import span_of
from aggregator.ledger.load_rows import read_book, read_span_sums
from aggregator.ledger.reader import read_sums, read_tubers, reading, the_run
from aggregator.ledger.writer import Ledger
from conveyor.messages import LoadAnswer, LoadOrder
from tests.aggregator.belt_story import Story, tell
from tests.aggregator.virtual_line import Aggregator

SEED = 5
S = 1_000_000_000


class Loads(Aggregator):
    """An aggregation whose loads change on the way, at places that are stated; the line states `stated_mm`."""

    stated_mm = 0.0

    def order(
        self, request: str, action: str, *, now_ns: int = 0, x_m: float | None = None, **more: object
    ) -> LoadAnswer:
        """Carry out an order as the node does."""
        asked = LoadOrder(request, action, by="me", place_x_m=x_m, **more)  # type: ignore[arg-type]
        line = {"stated_offset_mm": self.stated_mm}
        event = decide(asked, self.ledger.loads, run=self.story.run, now_ns=now_ns, line=line, place_x_m=self.place_x_m)
        self.ledger.say(event)
        return answer(asked, event, self.ledger.loads)

    def place_x_m(self, order: LoadOrder) -> float:
        assert order.place_x_m is not None
        return order.place_x_m


def story() -> Story:
    return tell(SEED, n=24, cameras=2, length_m=2.0, noise_mm=0.0)


def by_span(path: Path) -> dict[int, list[float]]:
    """Weights of the tubers of each load, by its number, from their rows alone."""
    with reading(path) as view:
        run = the_run(view, path, None).run
        spans = read_book(view).spans[run]
        found: dict[int, list[float]] = {span.load: [] for span in spans}
        for tuber in read_tubers(view, run):
            found[span_of(spans, tuber.place_x_m).load].append(tuber.weight_g)
        return found


def sums_by_load(path: Path) -> dict[int, tuple[int, float]]:
    """(count, grams) of each load by the sums carried along."""
    with reading(path) as view:
        run = the_run(view, path, None).run
        sums, found = read_span_sums(view, run), dict[int, tuple[int, float]]()
        for span in read_book(view).spans[run]:
            count, grams = found.get(span.load, (0, 0.0))
            load = sums[span.n].load
            found[span.load] = (count + load.count, grams + load.as_weighed_g)
        whole = read_sums(view, run).load
    assert sum(count for count, _ in found.values()) == whole.count
    assert sum(grams for _, grams in found.values()) == pytest.approx(whole.as_weighed_g)
    return found


def told_with_loads(ledger: Ledger) -> Loads:
    """A story during which one load follows another, with a pause."""
    it = Loads(ledger, story())
    for n in it.commits():
        if n == 2:
            it.order("a", "start", x_m=-0.4, fields={"name": "A", "variety": "Agria"})
        if n == 4:
            it.order("b", "start", x_m=-0.9, fields={"name": "B"})
        if n == 6:
            it.order("c", "end", x_m=-1.5)
    assert it.core.finished
    return it
