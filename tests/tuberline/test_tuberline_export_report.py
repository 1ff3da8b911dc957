"""A report's sentences and tables by themselves: what it says of times and of what went wrong, and odd texts."""

from __future__ import annotations

import re
import shutil
import sqlite3
import subprocess
import time
from contextlib import closing, nullcontext
from dataclasses import replace
from html import escape
from pathlib import Path

import numpy as np
import pytest

from aggregator.ledger.writer import Ledger
from tests.written_run import write_run
from tuberline.alarms.message import AlarmMessage
from tuberline.alarms.outbox import TABLES, Outbox
from tuberline.export.report.gather import day_facts
from tuberline.export.report.html import report_html
from tuberline.export.report.page import Bars, Figures, Grid, Report, Sentences
from tuberline.export.report.pdf import report_pdf
from tuberline.export.report.sections import report_of
from tuberline.export.report.wrong import what_went_wrong


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of one camera."""
    folder = tmp_path_factory.mktemp("report") / "monday"
    seconds = 1_790_000_000 + np.arange(40)
    write_run(folder, run="monday", crossed_ns=seconds * 1_000_000_000, weight_g=np.full(40, 170.0))
    return folder


def test_the_report_says_of_which_zone_its_times_are(run: Path) -> None:
    facts = day_facts([run])
    load = replace(facts.loads[0], label="1 A", began="08:05", ended="09:10", zone="UTC+2")
    winter = replace(load, label="2 B", began="07:00", ended="", zone="UTC+1")
    for loads, head, times in (
        ((load, replace(load, began="11:00", ended="")), "Time, UTC+2", ["08:05–09:10", "11:00"]),
        ((load, winter), "Time", ["08:05–09:10 UTC+2", "07:00 UTC+1"]),
    ):
        report = report_of(replace(facts, loads=loads), map_png=None, map_note="")
        (grid,) = [block for block in report.blocks if isinstance(block, Grid) and block.title == "Loads"]
        assert grid.columns[3][0] == head
        assert [row[3] for row in grid.rows[:2]] == times


def test_the_pdf_report_takes_no_text_for_markup(tmp_path: Path) -> None:
    pytest.importorskip("typst")
    pdftotext = shutil.which("pdftotext")
    odd = '#panic("x") $ <b>& *bold* \\'
    grid = Grid("Loads", (("Load", "left"), ("kg", "right")), ((odd, "1.0"), ("all", "1.0")), summed=True)
    bars = Bars(
        "Classes", ((odd, "#112233"), ("large", "#445566")), ((odd, odd, (0.25, 0.75)), ("empty", "", (0.0, 0.0)))
    )
    report = Report(odd, odd, (Figures(((odd, "1", odd),)), grid, bars, Sentences("Wrong", (odd,), warn=True)), odd)
    html = report_html(report)
    assert "<b>&" not in html
    assert html.count(escape(odd)) == 11
    (tmp_path / "report.pdf").write_bytes(report_pdf(report))
    if pdftotext:
        text = subprocess.run(
            [pdftotext, tmp_path / "report.pdf", "-"], capture_output=True, text=True, check=True
        ).stdout
        assert text.count("#panic") == 10, "all but the title of the window"


def test_a_long_word_leaves_the_figures_beside_it_to_be_read(run: Path, tmp_path: Path) -> None:
    """In HTML all columns of weights lay outside of the page, on A4 names lay over each other and labels over bars."""
    pytest.importorskip("typst")
    facts = day_facts([run])
    named = [
        replace(facts.loads[0], label=f"{n} {name}", field=field)
        for n, (name, field) in enumerate([("x" * 120, "y" * 200), ("trailer", "North 4"), ("Wald " * 40, "z" * 30)])
    ]
    report = report_of(replace(facts, loads=tuple(named)), map_png=None, map_note="")
    bars = Bars("Classes", (("small", "#112233"),), tuple((load.label, "0.0 % foreign", (1.0,)) for load in named))
    report = replace(report, blocks=(*report.blocks, bars))
    html = report_html(report)
    assert not re.search("[x-z]{13}", html)
    assert html.replace("<wbr>", "").count("y" * 200) == 1
    if (pdftotext := shutil.which("pdftotext")) is None:
        return
    (tmp_path / "report.pdf").write_bytes(report_pdf(report))
    found = subprocess.run(
        [pdftotext, "-bbox", tmp_path / "report.pdf", "-"], capture_output=True, text=True, check=True
    ).stdout
    for page in found.split("<page ")[1:]:
        words = [
            [float(value) for value in box]
            for box in re.findall(r'<word xMin="([\d.]+)" yMin="([\d.]+)" xMax="([\d.]+)" yMax="([\d.]+)"', page)
        ]
        assert max(x1 for _, _, x1, _ in words) < 548, "within the margin of A4: 210 mm less 17"
        over = [
            (a, b)
            for n, a in enumerate(words)
            for b in words[:n]
            if min(a[2], b[2]) - max(a[0], b[0]) > 2 and min(a[3], b[3]) - max(a[1], b[1]) > 4
        ]
        assert not over, over[:3]


def test_what_went_wrong_is_said_in_words(run: Path) -> None:
    facts = day_facts([run])
    (load,), (of_run,) = facts.loads, facts.runs
    missed = replace(
        load, label="7 trailer", coverage=0.8, unseen_m={"between_frames": 3.21}, ticket_kg=2 * load.high_kg
    )
    sheet = {"frames": {"published": 100, "gaps": 7, "dropped_blind": 1}, "views": {"sent": 10, "lost_late": 5}}
    lower = {"cameras": "left", "lower_mm": 3.2, "lower_sd_mm": 0.5, "scale_percent": -1.0, "scale_sd_percent": 2.0}
    lower |= {"tubers": 900, "loads": 3, "alarm": True}
    apart = {"first": "left", "second": "right", "along_mm": 1.0, "across_mm": 40.0}
    apart |= {"shared": 20, "twice": 18, "alarm": True}
    heights = [{"name": "7 trailer", "number": 1, "heights": [lower]}, {"name": "", "number": 2}]
    heights.append({"name": "of another day", "number": 3, "heights": [lower]})
    broken = replace(
        of_run,
        loads=frozenset((1, 2)),
        summary={
            "cameras": {"left": sheet},
            "differences": ["tubers do not add up"],
            "loads": heights,
            "totals": {"apart": [apart, {**apart, "second": "rear", "alarm": False}]},
        },
    )
    others = (replace(of_run, run=end, summary={}, end=end) for end in ("stopped", "goes on", "cut off"))
    dark = replace(load, label="8 box", tubers=0, coverage=0.0)
    assert what_went_wrong(replace(facts, loads=(dark,), runs=()))[0] == "Load 8 box: no belt was seen."
    told = what_went_wrong(replace(facts, loads=(missed,), runs=(broken, *others)))
    assert told[0] == (
        "Load 7 trailer: 20 % of its belt was not seen (3.2 m between two frames used, mean of the cameras). "
        "Its weight makes up for that."
    )
    assert told[1].startswith("Load 7 trailer: its ticket says ")
    assert told[3:] == [
        "The balance sheet of run monday does not hold: tubers do not add up. `tuberline audit` says more.",
        "Run monday: cameras left and right put the same tubers 1 mm apart along the belt and 40 mm across, 18 of 20 "
        "counted twice. A camera moved, its place is not right or, along the belt, two clocks differ: record both, "
        "then run `tuberline calibrate cameras`.",
        "Load 7 trailer: under camera left tubers lie 3.2 mm lower (± 0.8) than in 3 earlier loads of this variety; "
        "height over width -1 % (± 3).",
        "Camera left of run monday: of 100 frames 7 lost on the way.",
        "Camera left of run monday: of 10 views 5 late.",
        "Run goes on goes on: this is what is committed so far.",
        "Run cut off was cut off: its aggregator ended without a word. This is what is committed.",
    ]


def test_a_run_that_was_stopped_is_told_as_stopped(run: Path, tmp_path: Path) -> None:
    """A live line is always stopped, and each of its days 'has not ended, or was cut off'."""
    folder = tmp_path / "live #1"
    seconds = 1_790_000_000 + np.arange(20)
    for name, late_s in (("morning", 0), ("noon", 100)):
        crossed_ns = (seconds + late_s) * 1_000_000_000
        write_run(folder, run=name, crossed_ns=crossed_ns, weight_g=np.full(20, 170.0), stopped=True)
    facts = day_facts([run, folder])
    ends = {each.run: each.end for each in facts.runs}
    assert ends == {"monday": "cameras ended", "morning": "stopped", "noon": "stopped"}
    assert not [words for words in what_went_wrong(facts) if words.startswith("Run ")]
    text = report_html(report_of(facts, map_png=None, map_note=""))
    assert text.count("<td>stopped</td>") == 2
    with Ledger(folder / "ledger.db") as ledger:
        ledger.open_run("evening", line="line", cameras=("left",), version="1", started_ns=1_790_000_200_000_000_000)
        assert [each.end for each in day_facts([folder]).runs] == ["stopped", "stopped", "goes on"]
    assert [each.end for each in day_facts([folder]).runs] == ["stopped", "stopped", "cut off"]
    (folder / "alarms").mkdir()
    alarm = AlarmMessage("a", "a", "begin", "line", "", "disk", "trouble", "The disk is full.", "", 1_790_000_000.0)
    with closing(sqlite3.connect(folder / "alarms" / "alarms.db")) as db:
        for name, columns in TABLES.items():
            db.execute(f"CREATE TABLE {name} ({columns})")
        db.execute("INSERT INTO active VALUES ('disk', ?, 0)", (alarm.encode(),))
        db.commit()
    for sending in (nullcontext(), Outbox(folder / "alarms", channels=("page",), keep=1)):
        with sending:  # which holds the file: it 'cannot be read: database is locked'
            told = what_went_wrong(day_facts([folder]))
        assert [words for words in told if "larm" in words] == ["Alarm since 2026-09-21 14:13 UTC: The disk is full."]
    (folder / "alarms").rename(tmp_path / "alarms of the line")
    (folder / "line.toml").write_text(
        '[cameras.left]\npath = "x"\n[alarms]\nchannels = ["https://a.example"]\nstate_dir = "../alarms of the line"\n'
    )
    assert what_went_wrong(day_facts([folder]))[-1].endswith("The disk is full."), "alarms.state_dir was not looked at"
    (folder / "line.toml").write_text("[aggregator]\nticket = 1\n")
    (told,) = day_facts([folder]).doubts
    assert "that it names are left out, contract and densities too" in told, "it ended a report"


def test_a_run_without_loads_is_of_the_day_by_the_clock_of_its_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was of the day by the clock of who reads it: a report made in an office abroad was of another day."""
    late_ns = (1_790_033_400 + np.arange(20)) * 1_000_000_000  # 23:30 of September 21st, UTC
    for name, utc_offset_s in (("stated", 7200), ("older", None)):
        folder, grams = tmp_path / name, np.full(20, 170.0)
        write_run(folder, run=name, crossed_ns=late_ns, weight_g=grams, utc_offset_s=utc_offset_s)
    try:
        for zone, older in (("UTC", "2026-09-21"), ("Asia/Tokyo", "2026-09-22")):
            monkeypatch.setenv("TZ", zone)
            time.tzset()
            assert [day_facts([tmp_path / name]).days for name in ("stated", "older")] == [("2026-09-22",), (older,)]
    finally:
        monkeypatch.undo()
        time.tzset()


def test_the_report_of_a_day_tells_of_its_runs_alone(run: Path, tmp_path: Path) -> None:
    """Those of all other days stood in its table of runs, and what had gone wrong with them."""
    next_day_ns = (1_790_086_400 + np.arange(20)) * 1_000_000_000
    write_run(tmp_path, run="tuesday", crossed_ns=next_day_ns, weight_g=np.full(20, 170.0))
    both = day_facts([run, tmp_path])
    assert [each.run for each in both.runs] == ["monday", "tuesday"]
    for day, name in zip(both.days, ("monday", "tuesday"), strict=True):
        facts = day_facts([run, tmp_path], day=day)
        assert ([each.run for each in facts.runs], facts.total.loads) == ([name], 1)
    loads = tuple(replace(load, began="08:05", ended="09:10", zone="UTC") for load in both.loads)
    report = report_of(replace(both, loads=loads), map_png=None, map_note="")
    (grid,) = [block for block in report.blocks if isinstance(block, Grid) and block.title == "Loads"]
    assert [row[3] for row in grid.rows[:2]] == ["09-21 08:05–09:10", "09-22 08:05–09:10"], "which day was not said"
    later = replace(both, days=("2026-09-21", "2027-09-22"), loads=(loads[0], replace(loads[1], day="2027-09-22")))
    blocks = report_of(later, map_png=None, map_note="").blocks
    (grid,) = [block for block in blocks if isinstance(block, Grid) and block.title == "Loads"]
    assert [row[3][:10] for row in grid.rows[:2]] == ["2026-09-21", "2027-09-22"], "the year was not said"
