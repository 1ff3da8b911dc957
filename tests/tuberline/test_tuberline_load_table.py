"""The tables of loads and of what they come to in a terminal of 80 columns."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from rich.console import Console

from aggregator.calibration.together import Together
from aggregator.ledger.totals_by import ALL, Total
from conveyor.zone import zone_told
from tuberline.cli.class_table import foreign_line
from tuberline.cli.ledger_totals import print_totals
from tuberline.cli.load_table import print_load, print_loads
from tuberline.cli.report import print_summary

SAID = {"trailer": "", "customer": "", "operator": "", "field": "North 4", "variety": "Agria", "undone": False}


def test_an_interval_has_two_ends_and_a_trailer_of_tons_its_ticket(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a load whose belt was mostly missed it said '9.04 ± 11.83' kg, as if it might weigh less than nothing."""
    monkeypatch.setenv("COLUMNS", "80")
    times = {"began_unix_s": 1.79e9, "ended_unix_s": 1.79e9 + 600, "open": False, "count": 19, "coverage": 0.403}
    missed = {"estimated_weight_g": 9040.0, "estimated_low_g": 3430.0, "estimated_high_g": 27100.0, "net_g": None}
    heavy = {"estimated_weight_g": 104.2e6, "estimated_low_g": 95e6, "estimated_high_g": 112e6, "net_g": 103.1e6}
    print_loads([{**SAID, **times, **missed, "number": 2, "name": "trailer 7"}])
    print_loads([{**SAID, **times, **heavy, "number": 1, "name": "Überlingen am See, Schlag 17b"}])
    told = capsys.readouterr().out
    for part in ("9.04 ", "3.43 to 27.10", "40.3 %", "104200 ", "95000 to 112000", "103100.0"):
        assert part in told, told
    print_loads([{**SAID, **times, **missed, "number": 3, "name": "", "count": 0, "coverage": None}])
    assert "9.04" not in capsys.readouterr().out, "no belt of it was seen: it weighs nothing that is known, not 0 kg"


def test_a_list_that_ends_before_the_first_load_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    """Of a day of 40 loads it showed the last 20, and looked complete."""
    load = {**SAID, "name": "", "open": False, "count": 0, "coverage": None, "net_g": None}
    loads = [{**load, "number": n, "began_unix_s": 1.79e9, "ended_unix_s": 1.79e9 + 600} for n in range(40, 0, -1)]
    print_loads(loads[:20], limit=20)
    assert "older loads, up to number 20, are there: --limit" in " ".join(capsys.readouterr().out.split())
    for shown, limit in ((loads, 50), (loads, 40), (loads[:3], 20)):
        print_loads(shown, limit=limit)
        assert "older loads" not in capsys.readouterr().out


def test_times_of_day_say_their_zone(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Who asked from another zone than the line's took them for the line's own."""
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TZ", "CET-1CEST,M3.5.0,M10.5.0/3")
    time.tzset()
    load = {**SAID, "number": 2, "name": "trailer 7", "open": False, "count": 19, "coverage": 0.403, "net_g": None}
    load |= {"estimated_weight_g": 9040.0, "estimated_low_g": 3430.0, "estimated_high_g": 27100.0}
    load |= {"began_unix_s": 1.79e9, "ended_unix_s": 1.79e9 + 600, "said": [{"unix_s": 1.8e9, "by": "", "text": "wet"}]}
    try:
        print_load(load)
    finally:
        monkeypatch.undo()
        time.tzset()
    first, second = capsys.readouterr().out.splitlines()[2:4]
    assert "09-21 16:13  16:23" in first, first
    assert second.count("UTC+2") == 2, second


def test_a_load_that_ended_with_its_run_says_so_below_what_was_said(capsys: pytest.CaptureFixture[str]) -> None:
    """Nobody says such an end, so its history stopped at its beginning."""
    load = {**SAID, "number": 2, "name": "trailer 7", "open": False, "count": 0, "coverage": None, "net_g": None}
    load |= {"began_unix_s": 1.79e9, "ended_unix_s": None, "said": [{"unix_s": 1.79e9, "by": "", "text": "began"}]}
    print_load(load)
    print_load(load | {"ended_unix_s": 1.79e9 + 600})
    print_load(load | {"open": True})
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if line.startswith("ended")] == ["ended with its run"]
    at = lines.index("ended with its run")
    assert lines[at - 1].endswith("unknown: began"), lines


def test_loads_are_told_in_pounds_where_a_person_asks_for_it(capsys: pytest.CaptureFixture[str]) -> None:
    """Their tickets, too, and what speaks against them; a note stays as its writer put it, as do names of loads."""
    load = {**SAID, "number": 1, "name": "sacks of 25 kg", "open": False, "count": 1200, "coverage": 0.99}
    load |= {"began_unix_s": 1.79e9, "ended_unix_s": 1.79e9 + 600, "net_g": 207.1e3}
    load |= {"estimated_weight_g": 206.4e3, "estimated_low_g": 199e3, "estimated_high_g": 214e3}
    load |= {"doubts": ["load 1 (sacks of 25 kg) says 207.100 kg, expected are 181.250 kg"], "said": []}
    texts = ("net ticket 207.1 kg", "20 kg were lost", "net ticket withdrawn")
    load["said"] = [{"unix_s": 1.79e9, "by": "me", "text": text} for text in texts]
    print_load(load, unit="lb")
    told = capsys.readouterr().out
    parts = (
        "lb, all belt",
        "455.0",
        "438.7 to 471.8",
        "456.6",
        "1: load 1 (sacks of 25 kg) says 456.6 lb, expected are 399.6",
    )
    for part in (*parts, "me: net ticket 456.6 lb", "me: 20 kg were lost", "withdrawn"):
        assert part in " ".join(told.split()), told
    print_load(load, unit="t")
    told = capsys.readouterr().out
    for part in ("t, all belt", "0.199 to 0.214", "0.2071", "says 0.2071 t"):
        assert part in " ".join(told.split()), told


@pytest.mark.parametrize(
    ("offset_s", "told"), [(0, "UTC"), (7200, "UTC+2"), (-12600, "UTC-3:30"), (20700, "UTC+5:45"), (-43200, "UTC-12")]
)
def test_a_zone_is_told_by_how_far_it_is_ahead(offset_s: int, told: str) -> None:
    assert zone_told(offset_s) == told


def total(label: str, *, kg: float, loads: int = 1, weighed: int = 0) -> Total:
    grams = 1000 * kg
    sums = Together(
        tubers=round(5.5 * kg), as_weighed_g=grams, weight_g=grams, seen_g=(grams, grams), estimated_g=grams,
        low_g=0.95 * grams, high_g=1.12 * grams, coverage=1.0, belt_m=100.0, parts_percent={"camera": 4.0},
        tickets=weighed,
    )  # fmt: skip
    return Total(label, loads, weighed, grams, grams, sums)


def test_no_label_and_no_figure_of_totals_is_cut(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """All days of a month read '2026-11…', and the interval of all lost its upper end."""
    monkeypatch.setenv("COLUMNS", "80")
    days = [f"2026-11-{day}" for day in (26, 27)]
    whole = total(ALL, kg=104_200, loads=1200, weighed=1100)
    print_totals([*(total(day, kg=8100, weighed=1) for day in days), whole], [], "day")
    told = capsys.readouterr().out
    figures = ("104200.00", "104200 ", "98990 to 116704", "573100", "100.0 %", "(1100 of 1200)", "8100.0 ")
    for part in (*days, "7695 to 9072", *figures):
        assert part in told, told
    assert "…" not in told

    run = "20261127T063215-north, without a load"
    print_totals([total("1 Anhänger 7", kg=8100, weighed=1), total(run, kg=20.1), whole], [], "load")
    told = capsys.readouterr().out
    width = told.splitlines()[1].index(" loads")
    labels = [line[:width].strip() for line in told.splitlines()]
    assert "1 Anhänger 7" in labels, told
    assert run.replace(" ", "") in "".join(labels).replace(" ", ""), told
    assert "…" not in told
    assert max(map(len, told.splitlines())) <= 80


def test_what_was_refused_is_told_in_the_fields_words() -> None:
    """It said 10 lump, 1 haulm: the words of the ledger."""
    shares = dict.fromkeys(("percent", "percent_low", "percent_high"), 1.0)
    weights = dict.fromkeys(("weight_percent", "weight_percent_low", "weight_percent_high"), 2.0)
    for kinds, said in (
        ({"lump": 10.0, "haulm": 1.0}, "; 10 clods or stones, 1 stalk of haulm"),
        ({"lump": 1.0, "haulm": 2.0}, "; 1 clod or stone, 2 stalks of haulm"),
        ({}, "; none refused"),
    ):
        assert foreign_line({**shares, **weights, "kinds": kinds}).endswith(said)


def test_brackets_in_names_are_no_markup(capsys: pytest.CaptureFixture[str]) -> None:
    """A folder [today] vanished from the paths that a replay ends with, and [gnss] from a reason."""
    grams = dict.fromkeys(("weight_g", "low_g", "high_g", "as_weighed_g"), 1000.0)
    told = {
        "count": 7,
        "coverage": 1.0,
        "histogram": [7],
        "histogram_step_g": 50.0,
        "calibrated_by": "3 [/bio]",
    }
    console = Console(width=80)
    print_summary(console, {"totals": grams | told, "balanced": True}, out=Path("[today]"))
    print_summary(console, {"totals": {}, "state": "nothing seen", "reason": "no [cameras.a]"}, out=Path("[today]"))
    said = capsys.readouterr().out
    assert all(text in said for text in ("3 [/bio]", "nothing seen: no [cameras.a]"))
    assert said.count("files: [today]/ledger.db, [today]/summary.json") == 2
