"""Columns of exported loads say the same as figures of these names elsewhere."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import pytest

from aggregator.ledger.at_rest import order_at_rest
from aggregator.ledger.writer import Ledger
from conveyor.errors import InputError
from conveyor.messages import LoadOrder
from tests.aggregator.belt_story import tell
from tests.aggregator.loaded_story import Loads, story, told_with_loads
from tests.aggregator.virtual_line import undisturbed
from tuberline.api.runs import read_totals
from tuberline.cli.export import export
from tuberline.cli.ledger_totals import totals
from tuberline.export.report.gather import day_facts
from tuberline.export.report.page import Figures, Grid
from tuberline.export.report.sections import report_of
from tuberline.export.tubers import about


def test_as_weighed_is_of_what_was_seen_and_raw_is_made_up_for_the_rest(tmp_path: Path) -> None:
    """`as_weighed_kg` of exports was made up for belt that was not seen, `as_weighed_g` of summaries was not."""
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = Loads(ledger, story())
        for n in it.commits():
            if n == 2:
                it.order("a", "start", x_m=-0.3, fields={"name": "A", "field": "Kamp", "variety": "Agria"})
            if n == 30:  # the line is stopped
                break
        ledger.open_run("dark", line="story", cameras=("left",), version="1", started_ns=1)
        weighed_kg = sum(tuber.weight_g for tuber in it.tubers()) / 1000
    export([tmp_path], format="csv", what="loads", out=tmp_path / "loads.csv")
    with (tmp_path / "loads.csv").open() as file:
        *loads, whole = csv.DictReader(file)
    assert about([tmp_path])["runs"][0]["grown"] == [{"field": "Kamp", "variety": "Agria"}]
    (dark,) = (row for row in loads if row["load"] == "dark")
    assert (dark["tubers"], dark["coverage"], dark["ticket_kg"]) == ("0", "", "")
    assert {dark[name] for name in dark if name.endswith("_kg")} == {""}, "nothing was seen: it said 0 kg, 0 to 0"
    loads.remove(dark)
    assert {row["load"] for row in loads} == {"story, without a load", "1 A"}
    assert float(whole["coverage"]) < 0.99
    assert float(whole["as_weighed_kg"]) == pytest.approx(weighed_kg)
    assert float(whole["raw_kg"]) > 1.01 * weighed_kg
    found = [total for total in read_totals(tmp_path, by="load") if total.label != "dark"]
    for row, total in zip([*loads, whole], found, strict=True):
        assert float(row["as_weighed_kg"]) == pytest.approx(total.sums.as_weighed_g / 1000)
        assert float(row["raw_kg"]) == pytest.approx(total.raw_g / 1000)
        assert float(row["weight_kg"]) == pytest.approx(float(row["raw_kg"])), "nothing is calibrated"


def test_what_was_not_seen_weighs_nothing_that_is_known(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`ledger totals` and the report told it as 0.00 kg, 0.00 to 0.00, and exports and `load show` as no weight."""
    with Ledger(tmp_path / "ledger.db") as ledger:
        ledger.open_run("dark", line="story", cameras=("left",), version="1", started_ns=1)
    with Ledger(tmp_path / "bare" / "ledger.db") as ledger:
        undisturbed(ledger, tell(6, n=0, cameras=1))
    totals(tmp_path, tmp_path / "bare")
    told = capsys.readouterr().out
    rows = [line.split()[1:] for line in told.splitlines() if " kg" not in line and line[:1].isalpha()]
    assert rows[0] == ["1", "0", "-", "-", "-", "-"]
    assert rows[1][:4] == ["1", "0", "0.00", "0.00"], told
    report = report_of(day_facts([tmp_path]), map_png=None, map_note="")
    figures = next(block for block in report.blocks if isinstance(block, Figures))
    assert figures.items[0] == ("Potatoes", "–", "no belt was seen")
    grid = next(block for block in report.blocks if isinstance(block, Grid))
    assert [row[5:9] for row in grid.rows] == [("–",) * 4] * 2


def test_what_passed_without_a_load_is_no_load(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Four that were started and such belt were a 'report of 5 loads', and with their tickets '4 of 5' on scales."""
    with Ledger(tmp_path / "ledger.db") as ledger:
        told_with_loads(ledger)
    for load in ("A", "B"):
        assert order_at_rest(tmp_path / "ledger.db", LoadOrder(load, "ticket", load=load, kg=1.2)).done
    found = {total.label: total for total in read_totals(tmp_path, by="load")}
    assert {label: (each.loads, each.weighed, each.without_load) for label, each in found.items()} == {
        "1 A": (1, 1, 0), "2 B": (1, 1, 0), "story, without a load": (0, 0, 1), "all": (2, 2, 1),
    }  # fmt: skip
    assert found["all"].sums.tubers == sum(each.sums.tubers for label, each in found.items() if label != "all")
    totals(tmp_path)
    told = capsys.readouterr().out
    assert "(2 of 2)" in told
    assert [line.split()[1] for line in told.splitlines() if line.startswith(("1 A", "all "))] == ["A", "2"]
    assert "a load - " in " ".join(told.split())
    export([tmp_path], format="html", out=tmp_path / "day.html")
    assert capsys.readouterr().out.startswith("report of 2 loads and what passed without one in ")
    report = report_of(day_facts([tmp_path]), map_png=None, map_note="")
    figures = next(block for block in report.blocks if isinstance(block, Figures))
    assert figures.items[1] == ("Loads", "2", f"{found['all'].sums.tubers} tubers, some without one")
    by_variety = next(block for block in report.blocks if isinstance(block, Grid) and block.title == "By variety")
    assert [(row[1], row[6]) for row in by_variety.rows] == [("1", "1 of 1")] * 2, "of B no variety is told"


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"format": "csv", "out": "a.xlsx"}, r"a\.xlsx is named as xlsx and would be csv: end its name in \.csv"),
        ({"format": "pdf", "out": "a.HTML"}, r"a\.HTML is named as html and would be pdf: end its name in \.pdf"),
        ({"format": "isoxml", "out": "a.csv"}, r"a\.csv is named as csv and would be isoxml: end its name in \.zip"),
        ({"format": "csv", "what": "loads", "track": ["way.csv"]}, "loads have no place: leave it out"),
    ],
)
def test_options_that_contradict_each_other_are_told(given: dict[str, Any], told: str, tmp_path: Path) -> None:
    """A PDF was written into a file named a.html, and positions were taken for loads and never used."""
    paths = {name: tmp_path / value for name, value in given.items() if name == "out"}
    tracks = {"track": [tmp_path / value for value in given["track"]]} if "track" in given else {}
    with pytest.raises(InputError, match=told):
        export([tmp_path], **{**given, **paths, **tracks})
    assert list(tmp_path.iterdir()) == []
