"""Tubers and percents by class add up to what passed: 151 of 150 tubers were told, and 99.8 % of the weight."""

from __future__ import annotations

import re
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from rich.text import Text

from conveyor.messages import ClassTotal
from tests.viewer.page_states import loaded_state
from tests.written_run import write_run
from tuberline.cli.class_table import class_table, classes_line
from tuberline.export.report.gather import day_facts
from tuberline.export.report.page import Grid
from tuberline.export.report.sections import report_of
from viewer.page.snapshot import snapshot

COUNTS = (3.5, 12.6, 49.6, 46.4, 37.9)
PERCENTS = (2.64, 8.34, 33.34, 30.34, 25.34)
CLASSES = tuple(
    ClassTotal(f"class {n}", 10.0 * n, 10.0 * n + 10, count, count, count, 255 * percent, 0.0, 25e3, percent, 0.0, 99.0)
    for n, (count, percent) in enumerate(zip(COUNTS, PERCENTS, strict=True))
)


def test_a_report_tells_as_many_tubers_by_class_as_passed(tmp_path: Path) -> None:
    crossed_ns = (1_790_000_000 + np.arange(150)) * 1_000_000_000
    write_run(tmp_path, run="monday", crossed_ns=crossed_ns, weight_g=np.full(150, 170.0))
    facts = day_facts([tmp_path])
    report = report_of(replace(facts, classes=CLASSES), map_png=None, map_note="")
    (grid,) = [block for block in report.blocks if isinstance(block, Grid) and block.title.startswith("Sizes")]
    assert sum(int(row[2]) for row in grid.rows) == facts.total.sums.tubers == 150
    assert sum(float(row[3]) for row in grid.rows) == pytest.approx(round(facts.total.sums.estimated_g / 1000, 1))
    assert sum(float(row[4].removesuffix(" %")) for row in grid.rows) == pytest.approx(100.0)


def test_a_terminal_tells_as_many_tubers_by_class_as_passed() -> None:
    console = Console(width=120, record=True, force_terminal=False)
    console.print(class_table("c", [asdict(each) for each in CLASSES]))
    cells = [re.findall(r"([\d.]+) \(", line) for line in console.export_text().splitlines() if " class" in line]
    rows = [[float(cell) for cell in row] for row in cells if len(row) == 3]
    assert len(rows) == len(CLASSES)
    assert [sum(column) for column in zip(*rows, strict=True)] == pytest.approx([150, 25.5, 100.0])
    line = Text.from_markup(classes_line(CLASSES)).plain
    assert sum(map(float, re.findall(r"([\d.]+) %", line))) == pytest.approx(100.0)


def test_the_page_tells_percents_that_add_up() -> None:
    state = loaded_state()
    assert state.totals is not None
    shown = snapshot(replace(state, totals=replace(state.totals, classes=CLASSES)))
    percents = [each["percent"] for each in shown["load"]["classes"]]
    assert sum(percents) == pytest.approx(100.0)
    assert percents == [round(percent, 1) for percent in percents], "as they are shown"
