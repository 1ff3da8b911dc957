"""Loads are found by number, however old, in a ledger and of a running line; `number:3` is always load 3."""

from __future__ import annotations

from pathlib import Path

import pytest

from aggregator.core.load_orders import find
from aggregator.core.load_sums import LoadSums
from aggregator.core.totals import LoadTotals
from aggregator.ledger.writer import Ledger
from aggregator.queries import Queries
from conveyor.config import LineConfig, LinkConfig
from conveyor.errors import InputError
from conveyor.messages.loads import number_meant
from conveyor.node import Node
from tests.aggregator.loaded_story import Loads, story
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


@pytest.mark.parametrize(
    ("wanted", "number"),
    [("3", 3), ("number:3", 3), ("number:", None), ("", None), ("A 3", None), ("-3", None), ("9" * 5000, None)],
)
def test_what_a_number_is(wanted: str, number: int | None) -> None:
    assert number_meant(wanted) == number
