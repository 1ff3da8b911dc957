"""The simulated day, very small: every stage runs, every table is written, and what they say agrees."""

from __future__ import annotations

import importlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from aggregator.ledger.totals_by import ALL, totals_by
from benchmarks.day import main
from benchmarks.day_stitch import Clock
from benchmarks.day_world import plan_day
from tuberline.cli.map import map_field

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "yield.md"
TABLES = ("stages", "loads", "classes", "foreign", "map", "exports")


@pytest.mark.parametrize("folder", ["benchmarks", "deploy/trial"])
def test_everything_that_is_run_by_name_is_imported(folder: str) -> None:
    """A benchmark named a thing that had moved: no one saw it until it was wanted. Here, where most is loaded."""
    modules = [path.stem for path in sorted((ROOT / folder).glob("[a-z]*.py"))]
    assert len(modules) > 10
    for name in modules:
        importlib.import_module(f"{folder.replace('/', '.')}.{name}")


def test_the_day_has_twenty_loads_of_three_hundred_tubers() -> None:
    plan, again = plan_day(), plan_day()
    assert [load.tubers for load in plan.loads] == [load.tubers for load in again.loads]
    assert len(plan.loads) == 20
    assert min(load.tubers for load in plan.loads) >= 300
    assert len({load.stock.cultivar for load in plan.loads}) == 3
    assert len({load.field for load in plan.loads}) == 2
    gaps_s = [(b.crossed_ns[0] - a.crossed_ns[-1]) / 1e9 for a, b in zip(plan.loads, plan.loads[1:], strict=False)]
    assert min(gaps_s) > 20, "the machine stands while its box is changed"
    assert all(len(where) == load.tubers for where, load in zip(plan.lifted, plan.loads, strict=True))


def test_a_stretched_clock_keeps_the_order() -> None:
    clock = Clock(np.array([1.0, 1.5, 3.0]), np.array([0.0, 20.0, 21.0]), 1000 * 10**9)
    days = [clock.day_ns(round(own_s * 1e9), first_ns=0) / 1e9 - 1000 for own_s in (0.5, 1.0, 1.25, 1.5, 3.0, 3.5)]
    assert days == pytest.approx([-0.5, 0.0, 10.0, 20.0, 21.0, 21.5])


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_a_small_day(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page, out = tmp_path / "yield.md", tmp_path / "day"
    shutil.copyfile(PAGE, page)
    small = [
        "--loads",
        "2",
        "--box-kg",
        "14",
        "--delay-s",
        "9",
        "--cell-m",
        "1",
        "--workers",
        "1",
        "--database",
        "none",
    ]
    main([*small, "--out", str(out), "--docs", str(page)])
    text = page.read_text()
    for name in TABLES:
        table = text.partition(f"<!-- day_{name}: begin -->")[2].partition("<!--")[0]
        assert table.count("|") > 10, name
    (total,) = (one for one in totals_by([out / "run"], "load")[0] if one.label == ALL)
    assert total.weighed == 2
    capsys.readouterr()
    map_field([out / "run"], cell_m=1.0, delay_s=9.0, json=True)
    (run,) = json.loads(capsys.readouterr().out)["runs"]
    assert run["kg"] == pytest.approx(total.sums.estimated_g / 1000), "each load is scaled by its own calibration"
    assert (out / "run" / "report.pdf").read_bytes()[:5] == b"%PDF-"
    assert "box 2" in (out / "run" / "report.html").read_text()
