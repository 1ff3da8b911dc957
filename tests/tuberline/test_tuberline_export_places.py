"""Places of tubers in exports: by the machine's positions alone, and each tuber once."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from conveyor.errors import InputError, LedgerError
from tests.tuberline.test_tuberline_export import HOW, run
from tests.written_run import write_run
from tuberline.api.runs import read_totals
from tuberline.cli.export import export
from tuberline.export.binary_files import write_parquet
from tuberline.export.cells import cut_at_180
from tuberline.export.isoxml.archive import read_time_logs
from tuberline.export.table import Column, Ring, Table
from tuberline.export.text_files import write_geojson
from tuberline.maps.field import Settings, field_map

__all__ = ["run"]


def _features(path: Path) -> list[dict[str, Any]]:
    features: list[dict[str, Any]] = json.loads(path.read_text())["features"]
    return features


def test_places_of_tubers_need_no_full_cell(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without one they were left out, though the machine's places were known: 'give a smaller --cell-m'."""
    told: dict[tuple[float, str], Any] = {}
    read = {"csv": Path.read_text, "geojson": _features, "isoxml": read_time_logs}
    for cell_m in (10.0, 1000.0):
        for form in ("csv", "geojson", "isoxml"):
            out = tmp_path / f"{cell_m:g}.{form}"
            export([run], format=form, out=out, cell_m=cell_m, **HOW)  # type: ignore[arg-type]
            told[cell_m, form] = read[form](out)
        assert "without their places" not in capsys.readouterr().err
    for form in ("csv", "geojson", "isoxml"):
        assert told[1000.0, form] == told[10.0, form]
    with pytest.raises(InputError, match="no cell of 1000 m has a quarter"):
        export([run], format="csv", what="cells", out=tmp_path / "cells.csv", cell_m=1000.0, **HOW)  # type: ignore[arg-type]


def test_places_of_tubers_need_no_width_where_the_delay_is_given(run: Path, tmp_path: Path) -> None:
    """Points have none: GeoJSON of tubers was refused for want of a working width."""
    how = {name: value for name, value in HOW.items() if name != "width_m"}
    for name, given in (("with", HOW), ("without", how)):
        for form in ("csv", "geojson"):
            export([run], format=form, out=tmp_path / f"{name}.{form}", **given)  # type: ignore[arg-type]
    assert (tmp_path / "with.csv").read_text() == (tmp_path / "without.csv").read_text()
    points = [
        [feature["geometry"] for feature in _features(tmp_path / f"{name}.geojson")] for name in ("with", "without")
    ]
    assert points[0] == points[1]
    assert sum(point is not None for point in points[1]) > 100
    with pytest.raises(InputError, match=r"needs the working width: give --width-m .*; to place tubers --delay-s will"):
        export([run], format="geojson", out=tmp_path / "none.geojson")
    for form, what in (("isoxml", "tubers"), ("csv", "cells")):
        with pytest.raises(InputError, match=r"needs the working width: .* in the line's config$"):
            export([run], format=form, what=what, out=tmp_path / "none", **how)  # type: ignore[arg-type]


def test_a_table_of_cells_says_where_they_are(run: Path, tmp_path: Path) -> None:
    """CSV, Parquet and workbooks of cells had no place at all."""
    for form in ("csv", "geojson"):
        export([run], format=form, what="cells", out=tmp_path / f"cells.{form}", **HOW)  # type: ignore[arg-type]
    with (tmp_path / "cells.csv").open() as file:
        rows = list(csv.DictReader(file))
    features = _features(tmp_path / "cells.geojson")
    for row, feature in zip(rows, features, strict=True):
        lon, lat = np.mean(feature["geometry"]["coordinates"][0][:4], axis=0)
        assert (float(row["lon_deg"]), float(row["lat_deg"])) == (pytest.approx(lon), pytest.approx(lat))


def test_a_run_without_positions_beside_one_with_them_is_named(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The tubers of both lost their places, and nothing was said."""
    bare = tmp_path / "bare"
    crossed_ns = (1_790_000_000 + np.arange(20)) * 1_000_000_000
    write_run(bare, run="tuesday", crossed_ns=crossed_ns, weight_g=np.full(20, 170.0))
    export([run, bare], format="csv", out=tmp_path / "out.csv", **HOW)  # type: ignore[arg-type]
    assert f"tubers without their places: run {bare} has no positions.csv" in capsys.readouterr().err
    track = run / "positions.csv"
    for day, tracks, words in (
        ("2026-09-21", [track], "2 runs and 1 tracks are given"),  # an IndexError, or the one of another run
        ("2020-01-01", [track, track], "no load of 2020-01-01: they hold 2026-09-21"),  # 'counted no tuber'
    ):
        with pytest.raises(InputError, match=words):
            export([bare, run], format="html", day=day, track=tracks, out=tmp_path / "day.html", **HOW)  # type: ignore[arg-type]


def test_a_run_and_a_copy_of_it_are_not_added_up(run: Path, tmp_path: Path) -> None:
    """After `cp -r runs/monday runs/safe` each tuber counted twice, in totals, exports, reports and maps."""
    safe = tmp_path / "safe"
    shutil.copytree(run, safe)
    words = r"monday/ledger\.db \((\d+) tubers\) and .*safe/ledger\.db \(\1 tubers\) both hold run 'monday', whose"
    for read in (
        lambda: export([run, safe], format="csv", out=tmp_path / "out"),
        lambda: export([run, safe], format="html", out=tmp_path / "out"),
        lambda: read_totals(run, safe),
        lambda: field_map([run, safe], [], Settings(**HOW)),
    ):
        with pytest.raises(LedgerError, match=words):
            read()


def test_cells_on_the_180th_meridian_lie_on_both_sides_of_it(tmp_path: Path) -> None:
    """Their rings went around the Earth the other way."""
    shapely, parquet = pytest.importorskip("shapely"), pytest.importorskip("pyarrow.parquet")
    across: Ring = [(179.9999, -16.8), (-179.9998, -16.8), (-179.9998, -16.7), (179.9999, -16.7), (179.9999, -16.8)]
    beside: Ring = [(179.9998, -16.8), (179.9999, -16.8), (179.9999, -16.7), (179.9998, -16.7), (179.9998, -16.8)]
    touching: Ring = [(179.9999 if lon == 179.9999 else -180.0, lat) for lon, lat in across]
    areas = [cut_at_180(ring) for ring in (across, beside, touching)]
    table = Table("cells", (Column("kg", "number", "kg", ""),), [(1.0,), (2.0,), (3.0,)], {}, areas)
    write_geojson(table, tmp_path / "cells.geojson")
    write_parquet(table, tmp_path / "cells.parquet", geometry=True)
    features = _features(tmp_path / "cells.geojson")
    made = [shapely.from_geojson(json.dumps(feature["geometry"])) for feature in features]
    stored = parquet.read_table(tmp_path / "cells.parquet")
    assert all(shapely.equals(shapely.from_wkb(stored["geometry"].to_pylist()), made))
    assert [shape.geom_type for shape in made] == ["MultiPolygon", "Polygon", "Polygon"]
    assert all(shapely.is_valid(made))
    assert [part.exterior.is_ccw for part in made[0].geoms] == [True, True]
    assert [shape.area for shape in made] == pytest.approx([3e-5, 1e-5, 1e-5])
    assert [part.bounds[::2] for part in made[0].geoms] == [(179.9999, 180.0), (-180.0, pytest.approx(-179.9998))]
    geo = json.loads(stored.schema.metadata[b"geo"])["columns"]["geometry"]
    assert geo["geometry_types"] == ["MultiPolygon", "Polygon"]
    assert geo["bbox"] == [179.9998, -16.8, pytest.approx(-179.9998), -16.7]
