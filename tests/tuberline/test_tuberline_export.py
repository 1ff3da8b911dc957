"""Exports as other programs read them: GDAL, DuckDB, openpyxl, the schemas of ISO 11783, npm's isoxml."""

from __future__ import annotations

import contextlib
import csv
import json
import shutil
import subprocess
import zipfile
from dataclasses import replace
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from aggregator.ledger.reader import read_tubers, reading
from camera_sim.sim.field import FieldWorld, simulate_field
from conveyor.errors import InputError
from conveyor.formats.positions import PositionsWriter
from tests.written_run import write_run
from tuberline.cli.export import export
from tuberline.export.counted import counted_on
from tuberline.export.isoxml.archive import read_time_logs
from tuberline.export.isoxml.task_data import PER_AREA, PER_TIME, log_of, task_xml
from tuberline.export.isoxml.time_log import LoggedValue, LogRecord, header_xml, pack_records, unpack_records
from tuberline.export.report.gather import day_facts
from tuberline.export.report.wrong import what_went_wrong
from tuberline.maps.field import Settings, field_map

pytest.importorskip("pyproj")
pa_parquet = pytest.importorskip("pyarrow.parquet")

WORLD = FieldWorld(size_m=(15.0, 60.0), shown_share=0.1, outages=1, stop_every_s=60, stop_s=12)
SEED = 7303
HOW = {"width_m": 3.0, "overlap_m": 0.1, "delay_s": 17.0}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run with its own positions.csv."""
    folder = tmp_path_factory.mktemp("field") / "monday"
    (day,) = simulate_field(WORLD, seed=SEED).machines
    write_run(folder, run="monday", crossed_ns=day.crossed_ns, weight_g=day.weight_g)
    with PositionsWriter(folder / "positions.csv") as file:
        for at_ns, lat, lon, quality in zip(day.time_ns, day.lat_deg, day.lon_deg, day.quality, strict=True):
            file.write((int(at_ns), int(at_ns), float(lat), float(lon), int(quality), 0.7, 14))
    return folder


@pytest.fixture(scope="module")
def weights_g(run: Path) -> list[float]:
    with reading(run / "ledger.db") as db:
        return [tuber.weight_g for tuber in read_tubers(db, "monday")]


def exported(run: Path, tmp_path: Path, form: str, what: str = "tubers") -> Path:
    out = tmp_path / f"out.{form}"
    export([run], format=form, what=what, out=out, **HOW)  # type: ignore[arg-type]
    return out


def test_csv_has_its_units_beside_it(run: Path, weights_g: list[float], tmp_path: Path) -> None:
    out = exported(run, tmp_path, "csv")
    with out.open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["weight_g"]) for row in rows] == weights_g
    placed = [row for row in rows if row["lat_deg"]]
    assert 0.8 * len(rows) < len(placed) < len(rows), "some passed while there was no fix"
    assert all(52.69 < float(row["lat_deg"]) < 52.71 for row in placed)
    told = json.loads(out.with_name("out.csv-metadata.json").read_text())
    units = {column["name"]: column.get("schema:unitText") for column in told["tableSchema"]["columns"]}
    assert list(units) == list(rows[0])
    assert (units["weight_g"], units["length_mm"], units["model"]) == ("g", "mm", None)
    (of_run,) = told["dc:description"]["runs"]
    assert (of_run["weights"], of_run["calibrated_by"], of_run["coverage"]) == (["written@0"], "nothing", 1.0)


@pytest.fixture(scope="module")
def stopped(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same crop and positions by a live line that was stopped at noon and started again in its folder."""
    folder = tmp_path_factory.mktemp("twice") / "monday"
    (day,) = simulate_field(WORLD, seed=SEED).machines
    half = len(day.crossed_ns) // 2
    for name, part in (("morning", slice(half)), ("noon", slice(half, None))):
        write_run(folder, run=name, crossed_ns=day.crossed_ns[part], weight_g=day.weight_g[part], stopped=True)
    shutil.copy(run / "positions.csv", folder / "positions.csv")
    return folder


def test_a_line_that_was_stopped_and_started_again_is_exported_whole(
    run: Path, stopped: Path, weights_g: list[float], tmp_path: Path
) -> None:
    """Every export, the report and the map refused a ledger with two runs ("choose one with --run", which none of them
    takes): from the second start of a line on there was nothing to be had of it. The files of a line that was stopped
    told no weights, no coverage and no sum."""
    with exported(stopped, tmp_path, "csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["weight_g"]) for row in rows] == weights_g
    assert {row["run"] for row in rows} == {"morning", "noon"}
    (told,) = json.loads((tmp_path / "out.csv-metadata.json").read_text())["dc:description"]["runs"]
    assert (told["run"], told["finished"], told["weights"]) == ("morning_to_noon", False, ["written@0"])
    assert told["weight_g"] == pytest.approx(sum(weights_g), rel=0.02)
    assert told["low_g"] < told["weight_g"] < told["high_g"]
    with exported(stopped, tmp_path, "csv", "loads").open() as file:
        loads = list(csv.DictReader(file))
    assert [row["load"] for row in loads] == ["morning", "noon", "all"]
    assert float(loads[-1]["weight_kg"]) == pytest.approx(told["weight_g"] / 1000)
    (once,), (twice,) = (field_map([folder], [], Settings(**HOW)).shares for folder in (run, stopped))
    assert twice.kg == pytest.approx(once.kg, rel=0.01)
    assert twice.points.kg.sum() == pytest.approx(once.points.kg.sum(), rel=0.01)


def test_the_report_of_a_line_that_was_stopped_tells_what_went_wrong(stopped: Path, tmp_path: Path) -> None:
    """A live line has no summary in its ledger when it is stopped, and all that the report knows of frames, views,
    balance, layers and alarms was left out; the summary lies beside the ledger."""
    folder = tmp_path / "monday"
    shutil.copytree(stopped, folder)
    summary = json.loads((folder / "summary.json").read_text())
    summary["differences"] = ["left: frames received does not hold"]
    (folder / "summary.json").write_text(json.dumps(summary))
    morning, noon = day_facts([folder]).runs
    assert (morning.models, noon.models) == ({"written@0": morning.models["written@0"]}, summary["models"])
    assert (morning.summary, noon.summary) == ({}, summary)
    assert any("balance sheet of run noon does not hold" in said for said in what_went_wrong(day_facts([folder])))
    summary["tubers"]["committed"] += 1  # written before the last tubers came: of another time
    (folder / "summary.json").write_text(json.dumps(summary))
    assert day_facts([folder]).runs[1].summary == {}


def test_parquet_opens_in_duckdb(run: Path, weights_g: list[float], tmp_path: Path) -> None:
    duckdb = pytest.importorskip("duckdb")
    out = exported(run, tmp_path, "parquet")
    ((count, sum_g, year),) = duckdb.sql(f"SELECT count(*), sum(weight_g), min(year(time)) FROM '{out}'").fetchall()
    assert (count, sum_g) == (len(weights_g), pytest.approx(sum(weights_g)))
    assert year == 2026
    schema = pa_parquet.read_schema(out)
    assert schema.field("weight_g").metadata[b"unit"] == b"g"
    assert json.loads(schema.metadata[b"tuberline"])["runs"][0]["run"] == "monday"


@pytest.mark.parametrize("what", ["tubers", "cells"])
def test_geojson_and_geoparquet_open_in_gdal(run: Path, tmp_path: Path, what: str) -> None:
    pyogrio = pytest.importorskip("pyogrio")
    shapely = pytest.importorskip("shapely")
    out = exported(run, tmp_path, "geojson", what)
    info = pyogrio.read_info(out)
    assert info["geometry_type"] == ("Point" if what == "tubers" else "Polygon")
    assert "4326" in info["crs"]
    bounds = pyogrio.read_bounds(out)[1]
    (west, south), (east, north) = np.nanmin(bounds[:2], axis=1), np.nanmax(bounds[2:], axis=1)
    assert (west, south) == (pytest.approx(5.75, abs=1e-3), pytest.approx(52.7, abs=1e-3))
    assert 0 <= east - west < 0.01
    assert 0 <= north - south < 0.01
    geo = exported(run, tmp_path, "geoparquet", what)
    table = pa_parquet.read_table(geo)
    told = json.loads(table.schema.metadata[b"geo"])
    assert (told["version"], told["primary_column"]) == ("1.1.0", "geometry")
    shapes = shapely.from_wkb([value for value in table["geometry"].to_pylist() if value is not None])
    assert all(shapely.is_valid(shapes))
    features = json.loads(out.read_text())["features"]
    of_json = [shapely.from_geojson(json.dumps(f["geometry"])) for f in features if f["geometry"] is not None]
    assert len(shapes) == len(of_json)
    assert shapely.bounds(shapes[0]) == pytest.approx(shapely.bounds(of_json[0]))
    if "Parquet" in pyogrio.list_drivers():
        assert pyogrio.read_info(geo)["features"] == len(table)


def test_a_workbook_has_tubers_loads_and_what_they_are(run: Path, weights_g: list[float], tmp_path: Path) -> None:
    pytest.importorskip("xlsxwriter")
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.load_workbook(exported(run, tmp_path, "xlsx"), read_only=True)
    assert book.sheetnames == ["tubers", "loads", "about"]
    head, units, *rows = book["tubers"].values
    at = head.index("weight_g")
    assert units[at] == "g"
    assert [row[at] for row in rows] == pytest.approx(weights_g, rel=1e-14)
    load = dict(zip(next(book["loads"].values), list(book["loads"].values)[-1], strict=True))
    assert load["tubers"] == len(weights_g)
    assert load["low_kg"] < load["weight_kg"] < load["high_kg"]


def test_isoxml_says_what_the_map_says(run: Path, tmp_path: Path) -> None:
    out = exported(run, tmp_path, "isoxml")
    (records,) = read_time_logs(out).values()
    flow_kg = sum(record.values[PER_TIME] for record in records) / 1e6
    (day,) = simulate_field(WORLD, seed=SEED).machines
    assert 0.8 * day.weight_g.sum() / 1000 < flow_kg <= 1.001 * day.weight_g.sum() / 1000
    yields = [record.values[PER_AREA] / 1e5 for record in records if PER_AREA in record.values]
    assert np.mean(yields) == pytest.approx(WORLD.mean_t_ha * WORLD.shown_share, rel=0.5)
    assert all((b.time - a.time).total_seconds() >= 1 for a, b in pairwise(records))


def test_isoxml_keeps_each_machines_own_kilograms(run: Path) -> None:
    """Of two machines the log had the map's kilograms and the task the ledger's, 4 % apart; tubers that passed before
    the first position were no part of the count; `---` in the name of weights made a file that is no XML."""
    field = field_map([run], [], Settings(**HOW))
    (own,) = field.shares
    other = replace(own, factor=1.25, points=own.points.scaled(1.25))
    told = {"weights": ["a---b@0"], "calibrated_by": "nothing", "coverage": None, "grown": []}
    root = ElementTree.fromstring(task_xml(replace(field, shares=(own, other)), {"runs": [told, told]}))
    for share, task in zip((own, other), root.iter("TSK"), strict=True):
        totals = {value.get("A"): int(value.get("B", "")) for value in task.iter("DLV")}
        assert totals == {"005A": round(own.kg), "005B": own.tubers}
        records = log_of(field, share)
        assert sum(record.values[PER_TIME] for record in records) / 1e6 + share.lost_kg == pytest.approx(own.kg)
        yields = [record.values[PER_AREA] / 1e5 for record in records if PER_AREA in record.values]
        assert yields == pytest.approx(list(share.factor * own.points.t_ha[own.points.used]), abs=1e-4)
    assert own.tubers == len(simulate_field(WORLD, seed=SEED).machines[0].weight_g)


def test_isoxml_validates_against_the_schemas(run: Path, shared: Path, tmp_path: Path) -> None:
    xmlschema = pytest.importorskip("xmlschema")
    folder = shared / "data" / "isoxml_examples" / "xsd"
    with zipfile.ZipFile(exported(run, tmp_path, "isoxml")) as archive:
        archive.extractall(tmp_path)
    task = xmlschema.XMLSchema(folder / "ISO11783_TaskFile_V4-3.xsd")
    log = xmlschema.XMLSchema(folder / "ISO11783_TimeLog_V4-3.xsd")
    task.validate(tmp_path / "TASKDATA" / "TASKDATA.XML")
    faults = [error.reason for error in log.iter_errors(tmp_path / "TASKDATA" / "TLG00001.XML")]
    told = {"weights": [], "calibrated_by": "nothing", "coverage": None}
    grown = [{"field": "Kamp", "variety": "Agria"}, {"field": "Berg", "variety": ""}, {"field": "", "variety": "agria"}]
    grown.append({"field": "Hof " * 20, "variety": "Fontane"})
    about = {"runs": [{**told, "grown": grown[:1]}, {**told, "grown": grown}]}
    field = field_map([run], [], Settings(**HOW))
    xml = task_xml(replace(field, shares=field.shares * 2), about).decode()
    task.validate(xml)
    root = ElementTree.fromstring(xml)
    assert [each.get("B") for each in root.iter("CVT")] == ["Agria", "Fontane"]
    fields = [(each.get("C"), each.get("G"), each.get("H")) for each in root.iter("PFD")]
    assert fields == [("Kamp", "CTP-1", "CVT-1"), ("Berg", "CTP-1", None), ("Hof " * 8, "CTP-1", "CVT-2")]
    assert [each.get("E") for each in root.iter("TSK")] == ["PFD-1", None], "a task is of one field at most"
    # A log refers to the device element of its TASKDATA.XML, which the schema of one file cannot see.
    assert set(faults) <= {"IDREF 'DET-1' not found in XML document"}


@pytest.mark.slow
def test_npms_isoxml_reads_our_values_back(run: Path, tmp_path: Path) -> None:
    if shutil.which("npm") is None:
        pytest.skip("npm is not installed: its isoxml cannot read the export")
    subprocess.run(["npm", "install", "--silent", "isoxml@1.11.2"], cwd=tmp_path, check=True, timeout=600)
    out = exported(run, tmp_path, "isoxml")
    script = """
        const {ISOXMLManager, TAGS} = require('isoxml'); const fs = require('fs');
        (async () => {
          const m = new ISOXMLManager();
          await m.parseISOXMLFile(new Uint8Array(fs.readFileSync(process.argv[1])), 'application/zip');
          const task = m.rootElement.attributes.Task[0];
          const log = task.attributes.TimeLog[0].parseBinaryFile();
          const told = {warnings: m.getWarnings().map(String), n: log.timeLogs.length, first: log.timeLogs[0]};
          console.log(JSON.stringify(told));
        })();"""
    done = subprocess.run(["node", "-e", script, str(out)], cwd=tmp_path, capture_output=True, text=True, check=True)
    told = json.loads(done.stdout)
    (records,) = read_time_logs(out).values()
    assert [text for text in told["warnings"] if "Letter case" not in text] == []
    assert told["n"] == len(records)
    first = told["first"]
    assert first["position"]["PositionNorth"] == pytest.approx(records[0].lat_deg, abs=1e-7)
    assert first["position"]["PositionEast"] == pytest.approx(records[0].lon_deg, abs=1e-7)
    assert sorted(v for k, v in first["values"].items()) == sorted(records[0].values.values())


def test_time_logs_of_other_terminals_are_read(shared: Path) -> None:
    folder = shared / "data" / "isoxml_examples"
    (records,) = read_time_logs(folder / "2021-04-09T15_33_26_taskdata.zip").values()
    assert len(records) > 10
    assert {record.time.year for record in records} == {2021}
    assert all(record.lat_deg is not None and 40 < record.lat_deg < 60 for record in records)
    assert read_time_logs(folder / "task_with_grid.zip") == {}


def test_the_map_in_a_days_report_is_of_that_day(run: Path, tmp_path: Path) -> None:
    """It was of all that the runs hold: of a season's ledger all fields, or none, for they lie too far apart."""
    folder = shutil.copytree(run, tmp_path / "season")
    (day,), later_ns = simulate_field(WORLD, seed=SEED).machines, 86_400_000_000_000
    write_run(folder, run="tuesday", crossed_ns=day.crossed_ns + later_ns, weight_g=day.weight_g)
    with counted_on([folder], "2026-09-21") as first, counted_on([folder], "2026-09-22") as second:
        monday, (tuesday, *_) = list(first[0]), second[0]
    assert (len(monday), {tuber.run for tuber in monday}, tuesday.run) == (len(day.weight_g), {"monday"}, "tuesday")
    export([folder], format="html", day="2026-09-21", out=tmp_path / "day.html", **HOW)  # type: ignore[arg-type]
    assert "all that was lifted in monday." in (tmp_path / "day.html").read_text()
    assert "monday_to_tuesday" not in (tmp_path / "day.html").read_text()


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"format": "pdf", "what": "loads"}, "--what loads chooses the rows of a table; pdf has all it needs"),
        ({"format": "isoxml", "what": "cells"}, "--what cells chooses the rows of a table; isoxml has all it needs"),
        ({"format": "csv", "day": "2026-09-21"}, "--day is of the report: give it with --format html or pdf; csv"),
        ({"format": "xlsx", "contract": Path("buyer.toml")}, "--contract is of the report: give it with --format html"),
    ],
)
def test_what_would_do_nothing_is_refused(run: Path, given: dict[str, Any], told: str, tmp_path: Path) -> None:
    """`--what loads` left the map out of a report, and a table held all days whichever was asked for."""
    with pytest.raises(InputError, match=told):
        export([run], **given, out=tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["duplicate-xmlid.zip", "grid-without-binary.zip", "task_full.zip", "test1.zip"])
def test_broken_archives_are_read_or_told(shared: Path, name: str) -> None:
    path = shared / "data" / "isoxml_examples" / name
    with contextlib.suppress(InputError):  # any other error is a fault
        assert all(isinstance(records, list) for records in read_time_logs(path).values())


def test_a_log_that_is_cut_short_or_lies_is_an_error(run: Path, tmp_path: Path) -> None:
    column = LoggedValue(84, "DET-1")
    record = LogRecord(datetime(2026, 9, 14, 12, 0, 0, 250000, UTC), 52.7, 5.75, {column: 45_000_00})
    header, data = header_xml([column]), pack_records([record, record], [column])
    assert unpack_records(header, data, where="log") == [record, record]
    with pytest.raises(InputError, match="ends within record 1"):
        unpack_records(header, data[:-1], where="log")
    with pytest.raises(InputError, match="record 0 has a value 0, its header names 0"):
        unpack_records(header_xml([]), data, where="log")
    with pytest.raises(InputError, match="is no XML"):
        unpack_records(b"<TIM", data, where="log")
    with pytest.raises(InputError, match="does not fit 32 bits"):
        pack_records([LogRecord(record.time, 52.7, 5.75, {column: 1 << 31})], [column])
    for year in (1970, 2160):  # it was a struct.error
        with pytest.raises(InputError, match=f"is of {year}-01-01, a log holds 1980-01-01 to 2159-06-06"):
            pack_records([replace(record, time=datetime(year, 1, 1, tzinfo=UTC))], [column])
    with pytest.raises(InputError, match="is at 'north', which is no number"):
        unpack_records(b'<TIM><PTN A="north"/></TIM>', data, where="log")
    (tmp_path / "two").mkdir()
    with pytest.raises(InputError, match="holds 0 files TASKDATA"):
        read_time_logs(tmp_path / "two")


def test_what_needs_a_place_says_so_and_nothing_is_left(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bare = tmp_path / "bare"
    shutil.copytree(run, bare, ignore=shutil.ignore_patterns("positions.csv"))
    for form, what in (("geojson", "tubers"), ("isoxml", "tubers"), ("csv", "cells")):
        with pytest.raises(InputError, match="needs to know where the machine was"):
            export([bare], format=form, what=what, out=tmp_path / "out")  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"geojson holds places, loads have none: export tubers or cells"):
        export([run], format="geojson", what="loads", out=tmp_path / "out", **HOW)  # type: ignore[arg-type]
    assert not list(tmp_path.glob("*out*"))
    export([bare], format="csv", out=tmp_path / "tubers.csv")
    assert "lat_deg" not in (tmp_path / "tubers.csv").read_text().splitlines()[0]
    export([run], format="csv", out=tmp_path / "unplaced.csv")  # positions, and nothing that says the working width
    assert (tmp_path / "unplaced.csv").read_text() == (tmp_path / "tubers.csv").read_text()
    assert "tubers without their places: a map needs the working width" in capsys.readouterr().err


def test_an_export_never_replaces_what_the_run_keeps(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`export RUN --format csv` wrote its rows over the run's own tubers.csv."""
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    (folder / "tubers.csv").write_text("the run's own\n", encoding="utf-8")
    export([folder], format="csv")
    assert "exported-tubers.csv" in capsys.readouterr().out
    assert (folder / "tubers.csv").read_text(encoding="utf-8") == "the run's own\n"
    tickets, track, buyer = (tmp_path / name for name in ("tickets.json", "track.csv", "buyer.toml"))
    (folder / "line.toml").write_text(f'[aggregator]\ntickets = "{tickets}"\n', encoding="utf-8")
    before = {path: path.read_bytes() for path in folder.iterdir()}
    for out in (*(folder / name for name in ("tubers.csv", "ledger.db", "ledger.ack", "positions.csv")), tickets):
        for form in ("csv", "html"):
            with pytest.raises(InputError, match="is the run's own file"):
                export([folder], format=form, out=out)  # type: ignore[arg-type]
    for out in (track, buyer):
        with pytest.raises(InputError, match="is read by this very command"):
            export([folder], format="html", track=[track], contract=buyer, out=out)
    with pytest.raises(InputError, match="is a folder: name a file"):
        export([folder], format="csv", out=tmp_path)
    assert {path: path.read_bytes() for path in before} == before


def test_a_run_that_is_named_twice_is_exported_once(run: Path, weights_g: list[float], tmp_path: Path) -> None:
    """Its tubers stood twice in the file, and the map's kilograms were twice the field's."""
    (tmp_path / "latest").symlink_to(run)
    runs, tracks = [run, run / "ledger.db", tmp_path / "latest"], [run / "positions.csv"] * 3
    export(runs, format="csv", track=tracks, out=tmp_path / "out.csv", **HOW)  # type: ignore[arg-type]
    assert len((tmp_path / "out.csv").read_text().splitlines()) == 1 + len(weights_g)


def test_the_report_is_one_file_that_tells_the_load(run: Path, tmp_path: Path) -> None:
    text = exported(run, tmp_path, "html").read_text()
    summary = json.loads((run / "summary.json").read_text())["totals"]
    assert f"{summary['estimated_weight_g'] / 1000:.1f} kg" in text
    assert f"{summary['count']:,} tubers".replace(",", " ") in text
    assert "written@0" in text
    assert text.count('src="data:image/png;base64,') == 1, "the map"
    assert not [word for word in ("http:", "https:", "<script", "<link") if word in text]
    assert "No load was on a scale: no ticket says how right these weights are." in text
    assert "kg: the same, for nothing is calibrated." in text, "it said 'kg: calibrated' above 'Not calibrated.'"
    assert "all of it" in text
    assert ("the rest is made up for" in text) == (summary["coverage"] <= 0.9995)
    with pytest.raises(InputError, match=r"no load of 2020-01-01: they hold 2026-09-21"):
        export([run], format="html", day="2020-01-01", out=tmp_path / "no.html", **HOW)  # type: ignore[arg-type]
