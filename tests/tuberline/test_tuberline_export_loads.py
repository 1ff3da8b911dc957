"""Columns of exported loads say the same as figures of these names elsewhere."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from aggregator.ledger.writer import Ledger
from tests.aggregator.loaded_story import Loads, story
from tuberline.api.runs import read_totals
from tuberline.cli.export import export
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
    totals = [total for total in read_totals(tmp_path, by="load") if total.label != "dark"]
    for row, total in zip([*loads, whole], totals, strict=True):
        assert float(row["as_weighed_kg"]) == pytest.approx(total.sums.as_weighed_g / 1000)
        assert float(row["raw_kg"]) == pytest.approx(total.raw_g / 1000)
        assert float(row["weight_kg"]) == pytest.approx(float(row["raw_kg"])), "nothing is calibrated"
