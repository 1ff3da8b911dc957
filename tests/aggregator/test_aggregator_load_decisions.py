"""Orders about loads: done once under one id, undone, refused in words, numbers and names told apart."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from aggregator.core.load_orders import UNDO_WITHIN_S, decide
from aggregator.core.loads import NO_LOAD, LoadBook, Said
from aggregator.ledger.check import check_file
from aggregator.ledger.writer import Ledger
from conveyor.errors import InputError
from conveyor.messages import LoadOrder
from conveyor.messages.loads import FIELDS
from tests.aggregator.loaded_story import Loads, S, by_span, story, sums_by_load
from tuberline.cli.address import LineAddress
from tuberline.cli.load_table import told_loads as asked_of


def test_an_order_again_is_done_once(tmp_path: Path) -> None:
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = Loads(ledger, story())
        it.commit()
        first = it.order("a", "start", x_m=-0.4, fields={"name": "A"})
        assert it.order("a", "start", x_m=-0.7, fields={"name": "A"}) == first
        assert [load.name for load in ledger.loads.loads.values()] == ["A"]
        assert it.order("b", "note", note="wet").load == 1
        assert it.order("b", "note", note="wet").event == 2
        assert len(ledger.loads.loads[1].notes) == 1


def test_an_id_stands_for_one_order(tmp_path: Path) -> None:
    """A form that was corrected was answered as done under the id of the first one, and nothing was changed."""
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = Loads(ledger, story())
        it.commit()
        orders: list[tuple[str, dict[str, Any]]] = [
            ("start", {"x_m": -0.4, "fields": {"name": "A"}}),
            ("ticket", {"load": "last", "kg": 8123.5}),
            ("start", {"x_m": -0.6, "fields": {"name": "B"}}),
            ("note", {"load": "A", "fields": {"name": "C"}}),
            ("end", {"x_m": -0.7}),
            ("undo", {}),
            ("end", {"x_m": -0.8, "note": "rain"}),
            ("start", {"x_m": -0.9, "load": "C"}),
        ]
        first = [it.order(f"r{n}", action, now_ns=n * S, **more) for n, (action, more) in enumerate(orders)]
        again = [it.order(f"r{n}", action, now_ns=90 * S, **more) for n, (action, more) in enumerate(orders)]
        assert [(told.event, told.load) for told in again] == [(told.event, told.load) for told in first]
        for request, action, more in [
            ("r0", "start", {"x_m": -0.4, "fields": {"name": "trailer 8"}}),
            ("r0", "note", {"fields": {"name": "A"}}),
            ("r0", "start", {"x_m": -0.4, "load": "A", "fields": {"name": "A"}}),
            ("r1", "ticket", {"load": "last", "kg": 8132.5}),
            ("r1", "ticket", {"load": "last", "kg": 8123.5, "net": False}),
            ("r1", "ticket", {"load": "2", "kg": 8123.5}),
            ("r3", "note", {"load": "B", "fields": {"name": "C"}}),
            ("r6", "end", {"x_m": -0.8}),
            ("r7", "start", {"x_m": -0.9, "fields": {"name": "C"}}),
        ]:
            with pytest.raises(InputError, match=f"order {request} was carried out already, with other content"):
                it.order(request, action, now_ns=90 * S, **more)
        with pytest.raises(InputError, match=r"load 1 \(C\): 8123.5 kg net on the scale.*under an id of its own"):
            it.order("r1", "ticket", load="last", kg=1.0)
        assert ledger.loads.last_n == len(orders)


def test_an_undo_gives_the_belt_back(tmp_path: Path) -> None:
    path = tmp_path / "ledger.db"
    with Ledger(path) as ledger:
        it = Loads(ledger, story())
        for n in it.commits():
            if n == 2:
                it.order("a", "start", x_m=-0.4, fields={"name": "A"})
            if n == 3:
                it.order("b", "start", x_m=-0.6, fields={"name": "B"}, now_ns=100 * S)
            if n == 20:
                assert ledger.span_sums("story")[2].load.count > 0
                assert ledger.loads.loads[1].ended_ns is not None
                with pytest.raises(InputError, match="was 61 s ago, a change can be undone within 60 s"):
                    it.order("late", "undo", now_ns=round((101 + UNDO_WITHIN_S) * S))
                with pytest.raises(InputError, match="set back by at least 90 s since the last change"):
                    it.order("back", "undo", now_ns=10 * S)
                undone = it.order("u", "undo", now_ns=110 * S)
                assert (undone.name, undone.text) == ("B", "the start of load 2 (B) is undone: load 1 (A) is open")
                assert ledger.loads.loads[1].ended_ns is None
                assert ledger.loads.loads[2].undone
                assert it.order("n", "note", note="still A").name == "A"
            if n == 22:
                it.order("e", "end", now_ns=200 * S, x_m=-1.7)
                told = it.order("ue", "undo", now_ns=210 * S).text
                assert told == "the end of load 1 (A) is undone: load 1 (A) is open"
                assert it.order("n2", "note", note="open again").name == "A"
    assert set(by_span(path)) == {NO_LOAD, 1}
    assert sums_by_load(path)[1][0] == sum(tuber.x_m < -0.4 for tuber in story().seen())
    assert check_file(path) == []


@pytest.mark.parametrize("step_s", [3600, -3600, 86400])
def test_a_clock_that_is_set_says_nothing_of_how_long_ago_a_change_was(step_s: int) -> None:
    """5 s after a start, an hour on by the clock, 'the last change was 3605 s ago' refused its undo."""
    book, asked = LoadBook(), LoadOrder("a", "start", by="test", fields={"name": "A"})
    book.apply(decide(asked, book, run="r", now_ns=100_000 * S, line={}, place_x_m=lambda _: -1.0))
    undo, now_ns = LoadOrder("u", "undo", by="test"), (100_005 + step_s) * S
    with pytest.raises(InputError, match="61 s ago"):
        decide(undo, book, run="r", now_ns=now_ns, line={}, place_x_m=lambda _: 0.0, ago_s=lambda _: 61.0)
    event = decide(undo, book, run="r", now_ns=now_ns, line={}, place_x_m=lambda _: 0.0, ago_s=lambda _: 5.0)
    book.apply(event)
    assert book.open_load("r") is None
    again = decide(undo, book, run="r", now_ns=now_ns + S, line={}, place_x_m=lambda _: 0.0, ago_s=lambda _: None)
    assert again is event, "asked again under its id it is done once"


def test_an_undo_leaves_what_would_be_there_without_the_change() -> None:
    """Fields and notes that came with a load's going on, the offset it went on with and the note of its end stayed."""
    book = LoadBook()

    def say(action: str, **more: Any) -> None:
        order = LoadOrder(f"r{book.last_n}", action, by="test", **more)  # type: ignore[arg-type]
        line = {"stated_offset_mm": float(book.last_n)}
        book.apply(decide(order, book, run="r", now_ns=S, line=line, place_x_m=lambda _: -float(book.last_n)))

    say("start", fields={"name": "A", "variety": "Agria"}, note="dry")
    before = book.loads[1]
    say("end", note="rain")
    say("undo")
    assert book.loads[1] == before
    say("end", note="full")
    before = book.loads[1]
    say("start", load="A", fields={"variety": "Fontane", "field": "Long Acre"}, note="from the second field")
    say("note", load="A", fields={"trailer": "7"}, note="said of the load as it is")
    say("undo")
    assert book.loads[1] == replace(before, trailer="7", notes=(*before.notes, book.loads[1].notes[-1]))


@pytest.mark.parametrize("seed", range(40))
def test_an_undo_is_the_history_without_the_change(seed: int) -> None:
    """Over random histories: after each undo, loads and stretches are those of the events that were not taken back."""
    rng, book, taken_back = np.random.default_rng(seed), LoadBook(), set[int]()
    for n in range(60):
        actions = ("start", "start", "end", "note", "ticket", "undo", "undo")
        action, which = str(rng.choice(actions)), str(rng.choice(["", "", "1", "2", "3"]))
        fields = {name: str(rng.integers(3)) for name in rng.choice(FIELDS, size=2)}
        more = {"start": {"fields": fields}, "note": {"fields": fields}, "ticket": {"kg": float(n + 1)}}.get(action, {})
        order = LoadOrder(f"r{n}", action, by="test", load="" if action == "undo" else which, note=f"n{n}", **more)  # type: ignore[arg-type]
        run, line = f"run{n // 30}", {"stated_offset_mm": float(n)}
        with suppress(InputError):
            event = decide(order, book, run=run, now_ns=n * S, line=line, place_x_m=lambda _, n=n: -float(n))  # type: ignore[misc]
            if event.kind is Said.UNDO:
                taken_back |= {event.n, int(event.payload["event"])}
            book.apply(event)
        kept = LoadBook.of(e for e in book.events.values() if e.n not in taken_back)
        undone = {number for number, load in book.loads.items() if load.undone}
        assert {n: load for n, load in book.loads.items() if n not in undone} == {
            n: load for n, load in kept.loads.items() if n not in undone
        }
        assert {run: spans for run, spans in book.spans.items() if len(spans) > 1} == kept.spans
    assert taken_back
    again = LoadBook.of(book.events.values())
    assert (again.loads, again.spans) == (book.loads, book.spans)


@pytest.mark.parametrize(
    ("action", "more", "error"),
    [
        ("end", {}, "no load is open: nothing to end"),
        ("undo", {}, "nothing to undo"),
        ("note", {"note": "x"}, "has no load yet: start one"),
        ("ticket", {"kg": 100.0, "load": "A"}, "no load 'A'; this ledger has none yet"),
    ],
)
def test_what_cannot_be_done_is_refused_in_words(
    action: str, more: dict[str, object], error: str, tmp_path: Path
) -> None:
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = Loads(ledger, story())
        with pytest.raises(InputError, match=error):
            it.order("a", action, **more)  # type: ignore[arg-type]
        assert ledger.loads.last_n == 0


def test_tickets_keep_what_was_there(tmp_path: Path) -> None:
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = Loads(ledger, story())
        it.order("a", "start", x_m=-0.4, fields={"name": "A"})
        it.order("t1", "ticket", kg=8123.0, load="A", now_ns=1)
        it.order("t2", "ticket", kg=8132.0, scale_error_kg=20.0, note="misread", now_ns=2)
        it.order("t3", "ticket", kg=8300.0, net=False, now_ns=3)
        load = ledger.loads.loads[1]
        net, gross = load.ticket(net=True), load.ticket(net=False)
        assert net is not None
        assert gross is not None
        assert (net.ticket_g, net.sd_g, gross.ticket_g) == (8132e3, 20e3, 8300e3)
        assert [(t.ticket_g, t.said_ns, t.said_by) for t in load.tickets if t.net] == [
            (8123e3, 1, "me"),
            (8132e3, 2, "me"),
        ]
        assert "withdrawn" in it.order("t4", "ticket", net=False).text
        assert ledger.loads.loads[1].ticket(net=False) is None
        with pytest.raises(InputError, match="no gross ticket to withdraw"):
            it.order("t5", "ticket", net=False)
        with pytest.raises(InputError, match="up to 200000 kg"):
            it.order("t6", "ticket", kg=1e6)


def test_a_number_that_is_also_a_name_is_refused(tmp_path: Path) -> None:
    """A ticket for the load named 3 went to load 3 without a word."""
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = Loads(ledger, story())
        for n, name in enumerate(["3", "2", "A", "last", "5"]):
            it.order(f"s{n}", "start", x_m=-0.1 * (n + 1), fields={"name": name})
        for wanted, said in [
            ("3", r"'3' is the number of load 3 \(A\) and the name of load 1 \(3\): give number:3 or number:1"),
            ("last", r"'last' is the newest load, load 5 \(5\), and the name of load 4 \(last\): give number:5 or"),
            ("number:9", "no load 'number:9'; the last ones are"),
        ]:
            with pytest.raises(InputError, match=said):
                it.order("t", "ticket", load=wanted, kg=1.0)
        for n, (wanted, number) in enumerate(
            [("2", 2), ("number:3", 3), ("number:1", 1), ("A", 3), ("4", 4), ("5", 5), ("", 5)]
        ):
            assert it.order(f"u{n}", "ticket", load=wanted, kg=1.0).load == number
        it.order("s", "start", x_m=-0.7, fields={"name": "number:3"})
        assert it.order("v", "ticket", load="number:3", kg=1.0).load == 3, "such a name has its own number"
    shown = {
        wanted: [load["number"] for load in asked_of(LineAddress(), tmp_path / "ledger.db", wanted=wanted, limit=9)]
        for wanted in ("3", "number:1", "A", "5")
    }
    assert shown == {"3": [3, 1], "number:1": [1], "A": [3], "5": [5]}, "all that it may mean are shown"
