"""A simulated day: 20 loads, three varieties, two cameras, gaps, tickets, two plots; all figures from one run.

    python -m benchmarks day --out runs/day --docs docs/yield.md --pictures docs/images

Belts are rendered, segmented and weighed load by load, and kept in OUT/belts: a run that was cut goes on. Then one run
of the line is written, tickets are entered, and commands make map, exports, report and sync of it. `--loads 2 --box-kg
14 --delay-s 9 --cell-m 1` is a small day. PostgreSQL is `--database URL`, or a server of its own where Debian's package
is installed.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from benchmarks.day_belts import make_belts, read_belt
from benchmarks.day_judge import Evening, class_table, foreign_table, load_table, stage_table, stages
from benchmarks.day_ledger import enter_ticket, write_day
from benchmarks.day_outputs import CELL_M, MapOptions, export_table, map_table, sync_table
from benchmarks.day_world import LOADS_A_FIELD, SEED, plan_day
from benchmarks.figures_in_docs import put_table
from benchmarks.options import above_zero, page_with, parser_of, whole_number
from conveyor.contract import read_contract

TABLES = tuple(f"day_{name}" for name in ("stages", "loads", "classes", "foreign", "map", "exports", "sync"))


def main(arguments: Sequence[str]) -> None:
    """Make the belts that are not kept yet, write the run, judge it."""
    parser = parser_of("day", __doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/day"))
    parser.add_argument("--seed", type=whole_number(0), default=SEED)
    parser.add_argument("--loads", type=whole_number(1), default=2 * LOADS_A_FIELD)
    parser.add_argument("--box-kg", type=above_zero, help="that fill a box; default: those of 300 and more tubers")
    parser.add_argument("--workers", type=whole_number(1), default=2)
    parser.add_argument("--database", help="postgresql://...; 'none': without")
    parser.add_argument("--delay-s", type=float, help="from ground to camera; default: found, which a small day cannot")
    parser.add_argument("--cell-m", type=above_zero, default=CELL_M, help="side of a cell of the map")
    parser.add_argument("--docs", type=page_with(*TABLES), help="page between whose marks the tables are put")
    parser.add_argument("--pictures", type=Path, help="folder for report.png and day-map.png")
    given = parser.parse_args(arguments)
    for name, text in tables(given):
        print(f"## {name}\n\n{text}", flush=True)
        if given.docs:
            put_table(given.docs, name, text.rstrip())
    if given.pictures:
        pictures(given.out / "run", given.pictures)


def tables(given: argparse.Namespace) -> Iterator[tuple[str, str]]:
    """(name, Markdown) of each table, as the day goes on."""
    plan = plan_day(given.seed, loads=given.loads, box_kg=given.box_kg)
    make_belts(plan, given.out / "belts", workers=given.workers)
    belts = [read_belt(given.out / "belts", load, plan.seed) for load in plan.loads]
    run = given.out / "run"
    shutil.rmtree(run, ignore_errors=True)
    write_day(plan, given.out / "belts", run)
    true_kg = [sum(row["weight_g"] for row in belt.truth["tubers"]) / 1000 for belt in belts]
    for load, kg in zip(plan.loads, true_kg, strict=True):
        enter_ticket(run, load, kg, seed=plan.seed)
    evening = Evening(run / "ledger.db", true_kg)
    yield "day_stages", stage_table(stages(evening, plan))
    yield "day_loads", load_table(evening, plan, belts)
    yield "day_classes", class_table(evening, plan, belts, read_contract(run / "contract.toml"))
    yield "day_foreign", foreign_table(evening, plan, belts)
    how = MapOptions(given.delay_s, given.cell_m)
    yield "day_map", map_table(plan, belts, run, how)
    yield "day_exports", export_table(run, how)
    with database(given.database) as url:
        if url:
            yield "day_sync", sync_table(run, url)


@contextmanager
def database(url: str | None) -> Iterator[str | None]:
    """The database given, or a server of its own; None where there is neither."""
    if url is not None:
        yield None if url == "none" else url
        return
    import pytest

    from tests.sync.postgres import Postgres

    try:
        server = Postgres()
    except pytest.skip.Exception as why:
        sys.stderr.write(f"{why}\n")
        yield None
        return
    try:
        server.start()
        yield server.url
    finally:
        server.remove()


def pictures(run: Path, folder: Path) -> None:
    """The report's first page and the map as PNG; pdftoppm draws the page."""
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(run / "map.png", folder / "day-map.png")
    if shutil.which("pdftoppm") is None:
        sys.stderr.write("report.png is left out, for pdftoppm is not installed here: apt-get install poppler-utils\n")
        return
    draw = ["pdftoppm", "-r", "80", "-f", "1", "-l", "1", "-singlefile", "-png"]
    subprocess.run([*draw, run / "report.pdf", folder / "report"], check=True)
