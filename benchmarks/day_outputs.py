"""What is made of the simulated day's run: map, exports read back, report, PostgreSQL; each by its own command."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from aggregator.ledger.reader import read_tubers, reading
from aggregator.ledger.totals_by import ALL, totals_by
from benchmarks.command import tuberline
from benchmarks.day_belts import RUN, Belt
from benchmarks.day_stitch import BETWEEN_ROWS_M
from benchmarks.day_world import PLOT, DayPlan
from conveyor.geometry import EARTH_M_PER_DEG

CELL_M = 2.25


@dataclass(frozen=True, slots=True)
class MapOptions:
    """What is given to commands that map: the side of a cell, and the delay where it shall not be found."""

    delay_s: float | None = None
    cell_m: float = CELL_M

    @property
    def words(self) -> tuple[str, ...]:
        """As the command line has them."""
        given = () if self.delay_s is None else ("--delay-s", str(self.delay_s))
        return ("--cell-m", str(self.cell_m), *given)


def map_table(plan: DayPlan, belts: Sequence[Belt], out: Path, how: MapOptions) -> str:
    """Draw the map, and a table of it against what grew where."""
    drawn = ("--out", out / "map.png", "--title", "Two plots")
    told = json.loads(tuberline("map", out, *how.words, "--json", *drawn))
    (run,) = told["runs"]
    lines = [
        "| plot | cells | tubers in a cell | t/ha | true | correlation | error, t/ha | cells held |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    cells = told["cells"]
    place = np.array([_east_north(cell) for cell in cells])
    names = list(dict.fromkeys(load.field for load in plan.loads))
    for n, name in enumerate(names):
        chosen, truth = _true_t_ha(plan, belts, name, place, n, how.cell_m)
        found = np.array([cells[i]["t_ha"] for i in chosen])
        weight = np.array([cells[i]["area_m2"] for i in chosen])
        low, high = (np.array([cells[i][key] for i in chosen]) for key in ("low_t_ha", "high_t_ha"))
        scale = np.average(truth, weights=weight) / np.average(found, weights=weight)
        held = (low * scale <= truth) & (truth <= high * scale)
        lines.append(
            f"| {name} | {len(chosen)} | {np.mean([cells[i]['tubers'] for i in chosen]):.0f} "
            f"| {np.average(found, weights=weight):.1f} | {np.average(truth, weights=weight):.1f} "
            f"| {np.corrcoef(found, truth)[0, 1]:.2f} | {np.abs(found * scale - truth).mean():.1f} "
            f"| {100 * held.mean():.0f} % |"
        )
    lines += ["", f"Delay found {run['delay_s']:.1f} s ({run['delay_by']}), true {PLOT.delay_s:g} s."]
    return "\n".join(lines) + "\n"


def _east_north(cell: dict[str, float]) -> tuple[float, float]:
    """Metres from the first plot's corner."""
    north = (cell["lat_deg"] - PLOT.origin_lat_deg) * EARTH_M_PER_DEG
    return (cell["lon_deg"] - PLOT.origin_lon_deg) * EARTH_M_PER_DEG * np.cos(np.radians(PLOT.origin_lat_deg)), north


def _true_t_ha(
    plan: DayPlan, belts: Sequence[Belt], name: str, place: np.ndarray, plot: int, cell_m: float
) -> tuple[list[int], np.ndarray]:
    """(cells of a plot in which tubers grew, their true t/ha): the pattern where they grew, by their mean weight."""
    rows = []
    corner = plan.plots[plot].world
    east_m, _ = _east_north({"lat_deg": corner.origin_lat_deg, "lon_deg": corner.origin_lon_deg})
    for n, load in enumerate(plan.loads):
        if load.field != name:
            continue
        tubers = sorted(belts[n].truth["tubers"], key=lambda row: BETWEEN_ROWS_M - row["place_x_m"])
        at = np.linspace(0, load.tubers - 1, len(tubers)).round().astype(int)
        xy = plan.lifted[n][at]
        pattern = plan.plots[plot].t_ha(xy - [east_m, 0.0])
        rows.append(np.column_stack([xy, pattern, [row["weight_g"] for row in tubers]]))
    grown = np.concatenate(rows)
    chosen, truth = [], []
    for i, centre in enumerate(place):
        inside = grown[(np.abs(grown[:, :2] - centre) <= cell_m / 2).all(axis=1)]
        if len(inside) >= 5:
            chosen.append(i)
            truth.append(len(inside) / (1 / inside[:, 2]).sum() * inside[:, 3].mean() / PLOT.tuber_g)
    return chosen, np.array(truth)


def export_table(out: Path, how: MapOptions) -> str:
    """Write every export by the command, read each back by another program, and compare with the ledger."""
    with reading(out / "ledger.db") as view:
        ledger = [tuber.weight_g for tuber in read_tubers(view, RUN)]
    (total,) = (one for one in totals_by([out], "load")[0] if one.label == ALL)
    lines = ["| file | kB | read by | rows | kg read | kg in the ledger |", "| --- | ---: | --- | ---: | ---: | ---: |"]
    readers: dict[str, tuple[str, str, Callable[[Path], tuple[int, float]]]] = {
        "csv": ("tubers.export.csv", "Python's csv", _of_csv),
        "parquet": ("tubers.parquet", "DuckDB", _of_parquet),
        "geoparquet": ("tubers.geo.parquet", "pyarrow", _of_geoparquet),
        "geojson": ("tubers.geojson", "GDAL", _of_geojson),
        "xlsx": ("tubers.xlsx", "openpyxl", _of_xlsx),
        "isoxml": ("taskdata.zip", "its own reader", _of_isoxml),
    }
    for form, (name, by, read) in readers.items():
        tuberline("export", out, "--format", form, "--out", out / name, *how.words)
        rows, kg = read(out / name)
        own = total.sums.estimated_g / 1000 if form == "isoxml" else sum(ledger) / 1000
        lines.append(f"| {name} | {(out / name).stat().st_size / 1000:.0f} | {by} | {rows} | {kg:.2f} | {own:.2f} |")
    for form in ("html", "pdf"):
        tuberline("export", out, "--format", form, *how.words)
        lines.append(f"| report.{form} | {(out / f'report.{form}').stat().st_size / 1000:.0f} | a person | | | |")
    return "\n".join(lines) + "\n"


def _of_csv(path: Path) -> tuple[int, float]:
    with path.open(encoding="utf-8") as file:
        grams = [float(row["weight_g"]) for row in csv.DictReader(file)]
    return len(grams), sum(grams) / 1000


def _of_parquet(path: Path) -> tuple[int, float]:
    import duckdb

    ((rows, grams),) = duckdb.connect().execute(f"SELECT count(*), sum(weight_g) FROM '{path}'").fetchall()
    return rows, grams / 1000


def _of_geoparquet(path: Path) -> tuple[int, float]:
    from pyarrow import parquet

    grams = parquet.read_table(path)["weight_g"].to_pylist()
    return len(grams), sum(grams) / 1000


def _of_geojson(path: Path) -> tuple[int, float]:
    from pyogrio.raw import read

    _, _, _, (grams,) = read(path, columns=["weight_g"], read_geometry=False)
    return len(grams), float(grams.sum()) / 1000


def _of_xlsx(path: Path) -> tuple[int, float]:
    import openpyxl

    head, _, *rows = openpyxl.load_workbook(path, read_only=True)["tubers"].values
    at = head.index("weight_g")
    return len(rows), sum(row[at] for row in rows) / 1000


def _of_isoxml(path: Path) -> tuple[int, float]:
    """Mass per time over the seconds of the log (DDI 87, mg/s)."""
    from tuberline.export.isoxml.archive import read_time_logs
    from tuberline.export.isoxml.task_data import PER_TIME

    records = [record for log in read_time_logs(path).values() for record in log]
    return len(records), sum(record.values.get(PER_TIME, 0) for record in records) / 1e6


def sync_table(out: Path, url: str) -> str:
    """Bring the ledger into PostgreSQL twice, and compare the read model with the ledger's own totals."""
    import psycopg

    first, second = (tuberline("sync", url, out).strip().rpartition(": ")[2] for _ in range(2))
    lines = [
        f"First sync: {first}; second: {second}.",
        "",
        "| variety | loads | tubers | kg in PostgreSQL | kg in the ledger |",
        "| --- | ---: | ---: | ---: | ---: |",
    ]
    own = {total.label: total.sums.estimated_g / 1000 for total in totals_by([out], "variety")[0]}
    with psycopg.connect(url) as connection:
        rows = connection.execute(
            "SELECT variety, loads, tubers, weight_kg FROM tuberline.totals_by_variety ORDER BY variety"
        ).fetchall()
    lines += [f"| {name} | {loads} | {tubers} | {kg:.2f} | {own[name]:.2f} |" for name, loads, tubers, kg in rows]
    return "\n".join(lines) + "\n"
