"""What is told of loads: found by number however old, `number:3` is always load 3, and an end after all belt."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from aggregator.core.load_orders import answer, decide, find
from aggregator.core.load_sums import LoadSums
from aggregator.core.totals import LoadTotals
from aggregator.ledger.load_list import told_loads as loads_of
from aggregator.ledger.reader import reading
from aggregator.ledger.writer import Ledger
from aggregator.orders import order_place_x_m
from aggregator.queries import Queries
from conveyor.config import LineConfig, LinkConfig
from conveyor.errors import InputError
from conveyor.messages import LoadOrder
from conveyor.messages.loads import number_meant
from conveyor.node import Node
from tests.aggregator.loaded_story import Loads, S, story
from tuberline.cli.address import LineAddress
from tuberline.cli.load_table import told_loads

LOADS = 55
"""More than a running line tells at once."""


@pytest.mark.graph
def test_a_load_is_found_by_its_number_where_no_name_collides_and_however_old_it_is(
    link: LinkConfig, tmp_path: Path
) -> None:
    """`tuberline load show 3` of a line with more than fifty loads said that there is no load 3."""
    file = tmp_path / "ledger.db"
    with Ledger(file) as ledger:
        it = Loads(ledger, story())
        for n in range(1, LOADS + 1):
            it.order(f"s{n}", "start", x_m=-0.01 * n, fields={"name": f"trailer; {n}%"})
        for wanted in ("3", "number:3", "number:003", "trailer; 3%"):
            assert find(ledger.loads, wanted, "story").number == 3
        assert it.order("t", "ticket", load="number:3", kg=1.0).load == 3
        it.order("e", "end", x_m=-0.9)
        assert it.order("r", "start", x_m=-0.9, load="number:3").name == "trailer; 3%"
    totals = LoadTotals(LoadSums(50.0)).message("story", coverage=1.0, cameras={}, final=False)
    with Node("aggregator", "aggregator", config=LineConfig(link=link), run="story") as node:
        queries = Queries(node, file, run="story", totals=totals)
        line = LineAddress(connect=link.router)
        for ledger_or_line in (file, None):
            for wanted in ("3", "number:3", "number:003", "trailer; 3%"):
                (load,) = told_loads(line, ledger_or_line, wanted=wanted, limit=20)
                assert load["number"] == 3, (ledger_or_line, wanted)
            with pytest.raises(
                InputError, match=r"no load 'number:99' is there; the newest are 55 \(trailer; 55%\), 54"
            ):
                told_loads(line, ledger_or_line, wanted="number:99", limit=20)
            assert len(told_loads(line, ledger_or_line, wanted="", limit=20)) == 20
        del queries


def test_all_that_was_said_of_a_load_is_listed_with_who_said_it(tmp_path: Path) -> None:
    """Ends, undos and that a load went on were in the ledger, and listed nowhere: who ended it was not to be seen."""
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = Loads(ledger, story())
        orders: list[tuple[str, dict[str, Any]]] = [
            ("start", {"x_m": -0.1, "fields": {"name": "A"}, "note": "wet"}),
            ("end", {"x_m": -0.2}),
            ("undo", {}),
            ("note", {"note": "stones", "fields": {"variety": "Agria"}}),
            ("end", {"x_m": -0.3, "note": "full"}),
            ("start", {"x_m": -0.4, "load": "A"}),
            ("ticket", {"load": "A", "kg": 8123.5}),
            ("ticket", {"load": "A"}),
        ]
        for n, (action, more) in enumerate(orders):
            it.order(f"o{n}", action, now_ns=n * S, **more)
    with reading(tmp_path / "ledger.db") as view:
        (load,) = loads_of(view, limit=9)
    assert {said["by"] for said in load["said"]} == {"me"}
    assert [(said["unix_s"], said["text"]) for said in load["said"]] == [
        *((0, "began"), (0, "wet"), (1, "ended"), (2, "the end is undone"), (3, "stones; variety is Agria")),
        *((4, "ended"), (4, "full"), (5, "went on"), (6, "net ticket 8123.5 kg"), (7, "net ticket withdrawn")),
    ]


def test_a_load_that_the_next_one_ended_says_so(tmp_path: Path) -> None:
    """One that was ended by hand had a line 'ended' in its history; one that ended as the next one began had none."""
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = Loads(ledger, story())
        orders: list[tuple[str, dict[str, Any]]] = [
            ("start", {"x_m": -0.1, "fields": {"name": "A"}}),
            ("start", {"x_m": -0.2, "fields": {"name": "B"}}),
            ("undo", {}),
            ("start", {"x_m": -0.3}),
            ("start", {"x_m": -0.4, "load": "A"}),
            ("end", {"x_m": -0.5}),
        ]
        for n, (action, more) in enumerate(orders):
            it.order(f"o{n}", action, now_ns=n * S, **more)
    with reading(tmp_path / "ledger.db") as view:
        third, first = loads_of(view, limit=9)
    assert [(said["unix_s"], said["by"], said["text"]) for said in first["said"]] == [
        (0, "me", "began"), (1, "me", "ended, for load 2 (B) began"), (2, "me", "the end is undone"),
        (3, "me", "ended, for load 3 began"), (4, "me", "went on"), (5, "me", "ended"),
    ]  # fmt: skip
    assert [said["text"] for said in third["said"]] == ["began", "ended, for load 1 (A) went on"]


def test_a_load_that_is_ended_after_the_belt_ends_there_in_words(
    tmp_path: Path,
) -> None:
    """The log said 'end of load 1 at -inf m', a refusal 'belt down to -inf m', and the answer nothing."""
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = Loads(ledger, story())
        started = it.order("a", "start", x_m=-0.3, fields={"name": "A"})
        it.commit_one_by_one()
        asked = LoadOrder("e", "end", by="me")
        event = decide(
            asked,
            ledger.loads,
            run="story",
            now_ns=S,
            line={},
            place_x_m=lambda order: order_place_x_m(order, ledger, it.core, it.now_s),
        )
        ledger.say(event)
        told = answer(asked, event, ledger.loads)
        assert (started.text, told.text) == ("load 1 (A) has begun", "load 1 (A) has ended at the end of the belt")
        assert (event.where, told.place_x_m) == ("at the end of the belt", None)
        assert [said.where for said in ledger.loads.events.values()] == ["at -0.300 m", "at the end of the belt"]
        assert replace(event, place_x_m=math.inf).where == "at the beginning of the run"
        with pytest.raises(InputError, match=r"cannot change at -5\.00 m: all belt of this run is committed"):
            order_place_x_m(LoadOrder("z", "start", place_x_m=-5.0), ledger, it.core, it.now_s)
    with reading(tmp_path / "ledger.db") as view:
        assert "Infinity" not in json.dumps(loads_of(view, limit=9))


@pytest.mark.parametrize(
    ("wanted", "number"),
    [("3", 3), ("number:3", 3), ("number:", None), ("", None), ("A 3", None), ("-3", None), ("9" * 5000, None)],
)
def test_what_a_number_is(wanted: str, number: int | None) -> None:
    assert number_meant(wanted) == number
