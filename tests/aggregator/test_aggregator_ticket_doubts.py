"""Tickets that contradict each other, and gross ones below the net ones, are told where they are entered and read."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from aggregator.ledger.at_rest import order_at_rest
from aggregator.ledger.load_list import told_loads
from aggregator.ledger.reader import reading
from aggregator.ledger.totals_by import all_loads, totals_by
from aggregator.ledger.writer import Ledger
from aggregator.report import Reporter
from conveyor.config import LineConfig
from conveyor.counters import CounterSet
from conveyor.messages import LoadAnswer, LoadOrder
from tests.aggregator.belt_story import tell
from tests.aggregator.finished_ledger import copied
from tests.aggregator.loaded_story import Loads
from tests.aggregator.test_aggregator_load_totals import day_of_loads
from tuberline.cli.calibrate_load import calibrate_load
from tuberline.cli.ledger_totals import totals
from tuberline.cli.load_table import print_load, print_loads
from tuberline.cli.ticket_options import TicketOptions
from tuberline.export.report.gather import day_facts
from tuberline.export.report.page import Grid
from tuberline.export.report.sections import kg, report_of
from tuberline.export.report.wrong import what_went_wrong
from viewer.page.state import ToldLoad

APART = re.compile(r"load of run story, load (\d) says [\d.]+ kg, expected are [\d.]+ kg, ([\d.]+) standard deviations")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A ledger with the loads A and B, of which none has a ticket."""
    day_of_loads(tmp_path / "ledger.db")
    return tmp_path / "ledger.db"


@pytest.fixture
def raw_kg(path: Path) -> dict[str, float]:
    return {total.label[-1]: total.raw_g / 1000 for total in totals_by([path], "load")[0] if total.label[0] in "12"}


def ticket(path: Path, load: str, kg: float, *, net: bool = True) -> LoadAnswer:
    return order_at_rest(path, LoadOrder(f"{load}-{kg}-{net}", "ticket", load=load, kg=kg, net=net))


def apart(text: str) -> dict[str, str]:
    """By load, how many standard deviations its ticket lies from the others."""
    return dict(APART.findall(text))


def told_by_calibrate_load(path: Path, folder: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, str]:
    options = TicketOptions(folder / "tickets.json")
    calibrate_load(path, load="A", options=options)
    capsys.readouterr()
    calibrate_load(path, load="B", options=options)
    return apart(capsys.readouterr().out)


def test_tickets_that_agree_are_answered_without_a_remark(path: Path, raw_kg: dict[str, float]) -> None:
    for load in "AB":
        assert ticket(path, load, 1.05 * raw_kg[load]).text.endswith("kg net on the scale")
    assert ticket(path, "B", 1.1 * raw_kg["B"], net=False).text.endswith("kg gross on the scale")
    with reading(path) as view:
        assert [load["doubts"] for load in told_loads(view, limit=9)] == [[], []]
    assert all_loads([path]).doubts == []


def test_contradicting_tickets_are_told_wherever_they_are_met(
    path: Path, raw_kg: dict[str, float], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of loads of 9.70 and 3.16 kg with tickets of 7.4 and 4.2 kg only `calibrate load` said that they contradict."""
    assert ticket(path, "A", 0.83 * raw_kg["A"]).text.endswith("kg net on the scale")
    answer = ticket(path, "B", 1.3 * raw_kg["B"])
    assert answer.done
    said = apart(answer.text)
    assert set(said) == {"1", "2"}, answer.text
    assert answer.text.index("load 2 says") < answer.text.index("load 1 says"), "the one that was entered comes first"
    assert all(float(sds) > 3.5 for sds in said.values())
    assert "it counts for little" in answer.text

    with reading(path) as view:
        loads = told_loads(view, limit=9)
    assert [load["refused"] for load in loads] == [[], []]
    for load in loads:
        (doubt,) = load["doubts"]
        number = str(load["number"])
        assert apart(doubt) == {number: said[number]}
        assert ToldLoad.of(load).doubts == (doubt,), "the page's list was silent"
    capsys.readouterr()
    print_loads(loads)
    assert apart(joined(capsys)) == said
    print_load(loads[0])
    assert apart(joined(capsys)) == {"2": said["2"]}

    totals(path)
    assert apart(joined(capsys)) == said
    totals(path, json=True)
    values = json.loads(capsys.readouterr().out)
    assert values["tickets_refused"] == []
    assert apart(" ".join(values["tickets_doubted"])) == said
    assert apart(" ".join(what_went_wrong(day_facts([path])))) == said
    for day, number in (("1970-01-02", "1"), ("1970-01-03", "2")):
        of_day = " ".join(what_went_wrong(day_facts([path], day=day)))
        assert apart(of_day) == {number: said[number]}, "the tickets of all days were told"

    assert told_by_calibrate_load(path, tmp_path, capsys) == said, "by the same rule"
    again = order_at_rest(path, LoadOrder(f"B-{1.3 * raw_kg['B']}-True", "ticket", load="B", kg=1.3 * raw_kg["B"]))
    assert again.text == answer.text, "asked again, answered again"
    assert order_at_rest(path, LoadOrder("w", "ticket", load="B")).text.endswith("is withdrawn")
    assert all_loads([path]).doubts == []


def joined(capsys: pytest.CaptureFixture[str]) -> str:
    """What was printed, without the breaks of a narrow terminal."""
    return " ".join(capsys.readouterr().out.split())


def test_a_ticket_that_contradicts_those_of_the_config_is_told(
    path: Path, raw_kg: dict[str, float], tmp_path: Path
) -> None:
    """What the file of tickets says stands on the other side, and only the new one is named where it is one of many."""
    for load in "AB":
        ticket(path, load, 1.05 * raw_kg[load])
    options = TicketOptions(tmp_path / "tickets.json")
    for load in "AB":
        calibrate_load(path, load=load, options=options)
    tickets = json.loads(options.tickets.read_text())
    for each in tickets["tickets"]:
        each["run"] = "monday"
    options.tickets.write_text(json.dumps(tickets))
    (tmp_path / "line.toml").write_text('[cameras.front]\npath = "r"\n[aggregator]\ntickets = "tickets.json"\n')
    assert set(apart(ticket(path, "B", 0.78 * raw_kg["B"]).text)) == {"2"}


def test_a_gross_ticket_below_the_net_one_is_kept_and_told(
    path: Path, raw_kg: dict[str, float], capsys: pytest.CaptureFixture[str]
) -> None:
    """Its soil weighed less than nothing, without a word."""
    words = "is below its net one"
    ticket(path, "A", raw_kg["A"])
    answer = ticket(path, "A", raw_kg["A"] - 0.2, net=False)
    assert answer.done
    assert "the gross ticket of load 1 (A)" in answer.text
    assert words in answer.text
    with reading(path) as view:
        loads = told_loads(view, limit=9)
    assert loads[1]["jacket_g"] == pytest.approx(-200.0)
    assert [words in " ".join(load["doubts"]) for load in loads] == [False, True]
    print_load(loads[1])
    assert words in joined(capsys)
    assert words in all_loads([path]).doubts[0]
    assert words in ticket(path, "A", raw_kg["A"] - 0.1).text, "the net one that comes after it, too"
    assert ticket(path, "A", raw_kg["A"] + 0.3, net=False).text.endswith("on the scale")


def test_the_report_of_a_day_tells_of_its_refused_tickets_alone(path: Path, raw_kg: dict[str, float]) -> None:
    assert ticket(path, "A", 2 * raw_kg["A"]).done
    told = {day: day_facts([path], day=day).refused for day in (None, "1970-01-02", "1970-01-03")}
    assert ["a ratio of 2.00" in words for words in told["1970-01-02"]] == [True]
    assert (told[None], told["1970-01-03"]) == (told["1970-01-02"], ())
    report = report_of(day_facts([path]), map_png=None, map_note="")
    (grid,) = [block for block in report.blocks if isinstance(block, Grid) and block.title == "Loads"]
    scale = kg(2 * raw_kg["A"], unit=False)
    assert [row[-1] for row in grid.rows] == ["–", scale, "–", f"{scale} (1 of 2)"], "it stood beside the weight of all"


def test_a_running_line_says_it_as_a_ledger_at_rest_does(path: Path, raw_kg: dict[str, float], tmp_path: Path) -> None:
    at_rest = copied(path, tmp_path / "rest")
    tickets = {"A": 0.83 * raw_kg["A"], "B": 1.3 * raw_kg["B"]}
    rest = [apart(ticket(at_rest, load, kg).text) for load, kg in tickets.items()]
    with Ledger(path) as ledger:
        it = Loads(ledger, tell(5, n=60, cameras=2, length_m=5.0, noise_mm=0.0))
        reporter, said = Reporter(ledger, it.core, config=LineConfig(), counters=CounterSet()), []
        for load, kg in tickets.items():
            it.order(load, "ticket", load=load, kg=kg)
            said.append(apart(reporter.ticket_remark(ledger.loads.events[load], 1.0)))
    assert said == rest
    assert [set(each) for each in said] == [set(), {"1", "2"}]
