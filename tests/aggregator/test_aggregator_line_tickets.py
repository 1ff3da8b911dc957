"""Which tickets calibrate which ledger where several are read together: those of its own line, and those for all."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aggregator.calibration.tickets import Ticket, read_tickets, write_tickets
from aggregator.calibration.together import OneLoad, together
from aggregator.core.totals import LoadTotals
from aggregator.ledger.at_rest import order_at_rest
from aggregator.ledger.line_tickets import tickets_by_ledger
from aggregator.ledger.load_totals import ticket_of_load
from aggregator.ledger.totals_by import Total, all_loads, totals_by
from aggregator.ledger.writer import Ledger
from conveyor.config import LINE_NAME, REPLAY_NAME
from conveyor.messages import LoadOrder
from tests.aggregator.belt_story import tell
from tests.aggregator.loaded_story import Loads
from tests.aggregator.test_aggregator_load_totals import load_of
from tuberline.export.report.gather import day_facts
from tuberline.export.tubers import about, loads_table

READS = 0.92
"""Of what tubers weigh, on every line here."""


def write_load(folder: Path, *, line: str, seed: int, weighed: bool) -> Path:
    """The folder of a line's run, which is one load, with a ticket where it was `weighed`."""

    class Named(Loads):
        pass

    Named.line = line
    folder.mkdir(parents=True)
    with Ledger(folder / "ledger.db") as ledger:
        it = Named(ledger, tell(seed, run=folder.name, n=60, cameras=2, length_m=5.0, noise_mm=0.0))
        for n in it.commits():
            if n == 1:
                it.order(f"{folder.name}-a", "start", x_m=0.5, fields={"name": folder.name})
        ledger.finish(it.story.run, "{}", sights=it.core.cameras.sights)
        if weighed:
            weighed_kg = sum(tuber.weight_g for tuber in it.tubers()) / 1000
            it.order(f"{folder.name}-t", "ticket", load="1", kg=weighed_kg / READS)
    return folder


def by_load(*folders: Path, tickets: tuple[Ticket, ...] = ()) -> dict[str, Total]:
    """By the load's name, which is that of its folder."""
    return {total.label.split()[-1]: total for total in totals_by(folders, "load", tickets=tickets)[0]}


def figures(total: Total) -> tuple[float, float, float, int]:
    sums = total.sums
    return sums.estimated_g, sums.low_g, sums.high_g, sums.tickets


def test_a_ticket_of_one_line_leaves_the_loads_of_another_as_they_are(tmp_path: Path) -> None:
    """Listed beside another line's folder, a load of 23.11 kg (19.64 to 26.59) read 23.66 kg (22.13 to 25.20)."""
    north = write_load(tmp_path / "north", line="north", seed=5, weighed=False)
    south = write_load(tmp_path / "south", line="south", seed=7, weighed=True)
    alone, together_ = by_load(north), by_load(north, south)
    assert figures(together_["north"]) == figures(alone["north"])
    assert together_["north"].sums.tickets == 0
    assert figures(together_["south"]) == figures(by_load(south)["south"])
    assert together_["south"].sums.tickets == 1
    rows = {row[0].split()[-1]: row for row in loads_table([north, south]).rows}
    assert rows["north"][2] == rows["north"][3], "an export calibrates as the totals do"
    assert rows["south"][3] > 1.03 * rows["south"][2]


@pytest.mark.parametrize(("line", "shared"), [("north", True), (LINE_NAME, False), (REPLAY_NAME, False)])
def test_a_line_that_was_started_in_another_folder_shares_its_tickets(tmp_path: Path, line: str, shared: bool) -> None:
    """It has the same cameras. Of lines that no one named that is not known."""
    monday = write_load(tmp_path / "monday", line=line, seed=5, weighed=False)
    tuesday = write_load(tmp_path / "tuesday", line=line, seed=7, weighed=True)
    alone, both = by_load(monday)["monday"], by_load(monday, tuesday)["monday"]
    assert (alone.sums.tickets, both.sums.tickets) == (0, int(shared))
    assert (figures(both) != figures(alone)) == shared
    first, second = about([monday, tuesday])["runs"]
    assert first["calibrated_by"] == (second["calibrated_by"] if shared else "nothing")
    assert first["weight_g"] == pytest.approx(both.sums.estimated_g), "what is said of a run and its rows are one"
    assert [len(tickets) for tickets in tickets_by_ledger([monday, tuesday])] == [int(shared), 1]
    assert figures(by_load(monday, monday, tuesday)["monday"]) == figures(both)
    alone_words = [words for words in all_loads([monday, tuesday]).doubts if "calibrate no other run here" in words]
    assert [words.split()[3] for words in alone_words] == ([] if shared else ["tuesday"])


def test_tickets_that_are_given_calibrate_all_lines(tmp_path: Path) -> None:
    north = write_load(tmp_path / "north", line="north", seed=5, weighed=False)
    south = write_load(tmp_path / "south", line="south", seed=7, weighed=True)
    given = (Ticket("earlier", "m", 10000.0, 20.0, 9200.0, 90.0, 1.0, tubers=60, per_mm_g=202.0),)
    found = by_load(north, south, tickets=given)
    assert {name: found[name].sums.tickets for name in ("north", "south")} == {"north": 1, "south": 2}


def test_tickets_of_other_weights_are_told(tmp_path: Path) -> None:
    """New weights in mid-season: totals went back to what was weighed, without a word."""
    north = write_load(tmp_path / "north", line="north", seed=5, weighed=False)
    old = Ticket("earlier", "old", 10000.0, 20.0, 9200.0, 90.0, 1.0, tubers=60, per_mm_g=202.0)
    (told,) = all_loads([north], tickets=[old]).doubts
    assert told.startswith("no ticket calibrates what m weighed: those at hand are of old.")
    assert all_loads([north], tickets=[old, replace(old, run="later", model="m")]).doubts == []
    assert all_loads([north], tickets=[replace(old, set_aside="two trailers")]).doubts == []


def test_a_ticket_that_the_line_sets_aside_does_not_come_back_with_another_folder(tmp_path: Path) -> None:
    monday = write_load(tmp_path / "monday", line="north", seed=5, weighed=False)
    tuesday = write_load(tmp_path / "tuesday", line="north", seed=7, weighed=True)
    write_tickets(tmp_path / "t.json", [replace(ticket_of_load(tuesday, "1"), set_aside="two trailers")])
    (monday / "line.toml").write_text('[cameras.front]\npath = "r"\n[aggregator]\ntickets = "../t.json"\n')
    assert read_tickets(tmp_path / "t.json")[0].set_aside
    found = all_loads([monday, tuesday])
    assert [[load.one.totals.tickets_used for load in found.of(folder)] for folder in (monday, tuesday)] == [[0], [1]]


def test_intervals_of_sums_over_two_lines_hold(rng: np.random.Generator) -> None:
    """300 days of two lines, what is shared drawn for each line: one has a ticket, the other none. They are added as if
    they were one line: too wide rather than too narrow.
    """
    days, inside, widths = 300, 0, []
    for _ in range(days):
        ones, true_sum_g = [], 0.0
        for ticketed in (True, False):
            shared = float(np.exp(rng.normal(0, 0.03)) * (1 - 0.022 * rng.normal(0, 4.0)) * np.exp(rng.normal(0, 0.02)))
            true_g = rng.uniform(40e3, 60e3, 6)
            told_g = true_g * shared * np.exp(rng.normal(0, 0.019, 6)) * rng.normal(1, 0.1 / np.sqrt(300), 6)
            told = [float(grams) for grams in told_g]
            ticket = Ticket("r", "m", true_g[0], 0.005 * true_g[0], told[0], 0.006 * told[0], 1.0,
                            per_mm_g=0.022 * told[0])  # fmt: skip
            tickets = (ticket,) if ticketed else ()
            ones += [OneLoad(LoadTotals(load_of(grams), tickets), 1.0, 60.0) for grams in told[1:]]
            true_sum_g += float(true_g[1:].sum())
        day = together(ones)
        inside += day.low_g <= true_sum_g <= day.high_g
        widths.append((day.high_g - day.low_g) / 2 / day.estimated_g)
    assert 0.9 <= inside / days <= 1.0
    assert 0.07 < float(np.median(widths)) < 0.12, "half of it is calibrated, half of it is not"


def test_loads_of_several_ledgers_that_are_called_alike_are_told_apart(tmp_path: Path) -> None:
    """Every ledger has a load 1: those of three days were one row of 3 loads, and their weights one sum."""
    folders = [write_load(tmp_path / day, line="north", seed=seed, weighed=False) for seed, day in enumerate("abc")]
    apart = [by_load(folder)[folder.name] for folder in folders]
    for folder in folders[:2]:
        order_at_rest(folder / "ledger.db", LoadOrder("n", "note", by="me", load="1", fields={"name": "trailer 7"}))
    told = {total.label: total for total in totals_by(folders, "load")[0] if total.label[0] == "1"}
    assert list(told) == ["1 trailer 7 (a)", "1 trailer 7 (b)", "1 c"]
    for total, alone in zip(told.values(), apart, strict=True):
        assert (total.loads, total.sums.tubers, total.raw_g) == (1, alone.sums.tubers, alone.raw_g)
    rows = loads_table(folders).rows
    assert [row[:2] for row in rows if row[0] in told] == [(name, one.sums.tubers) for name, one in told.items()]
    assert {load.label for load in day_facts(folders).loads} >= set(told)


def test_loads_of_two_lines_that_began_in_the_same_second_are_told_apart(tmp_path: Path) -> None:
    run = "20261129T093155Z"
    folders = [
        write_load(tmp_path / line / run, line=line, seed=seed, weighed=False) for seed, line in enumerate(("n", "s"))
    ]
    told = [total.label for total in totals_by(folders, "load")[0] if total.label[0] == "1"]
    assert told == [f"1 {run} ({line}, {run})" for line in ("n", "s")]
