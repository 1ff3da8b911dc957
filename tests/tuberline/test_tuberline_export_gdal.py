"""GeoParquet as GDAL's own Parquet driver opens it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.tuberline.gdal_parquet import parquet_driver
from tests.tuberline.test_tuberline_export import exported, run

__all__ = ["run"]
pytest.importorskip("pyproj")
pa_parquet = pytest.importorskip("pyarrow.parquet")

READ = """
import json, sys
import pyogrio, pyogrio.raw
info = pyogrio.read_info(sys.argv[1])
meta, _, shapes, columns = pyogrio.raw.read(sys.argv[1], columns=sys.argv[2].split(","))
json.dump({
    "drivers": pyogrio.list_drivers(), "driver": info["driver"], "crs": info["crs"], "type": info["geometry_type"],
    "count": info["features"], "fields": list(info["fields"]),
    "shapes": [None if shape is None else shape.hex() for shape in shapes],
    "columns": {name: column.tolist() for name, column in zip(meta["fields"], columns)},
}, sys.stdout)
"""


@pytest.fixture(scope="module")
def driver(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder with the driver, which takes two minutes to build."""
    return parquet_driver(tmp_path_factory.mktemp("gdal"))


def read_by_gdal(path: Path, driver: Path, *columns: str) -> dict[str, Any]:
    """What GDAL says of the file, in a process of its own: GDAL looks for drivers once."""
    done = subprocess.run(
        [sys.executable, "-c", READ, str(path), ",".join(columns)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "GDAL_DRIVER_PATH": str(driver)},
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    told: dict[str, Any] = json.loads(done.stdout)
    return told


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    ("what", "kind", "columns"),
    [("tubers", "Point", ("weight_g", "length_mm", "model")), ("cells", "Polygon", ("t_ha", "tubers"))],
)
def test_gdals_own_driver_reads_geoparquet(
    run: Path, driver: Path, tmp_path: Path, what: str, kind: str, columns: tuple[str, ...]
) -> None:
    shapely = pytest.importorskip("shapely")
    path = exported(run, tmp_path, "geoparquet", what)
    table = pa_parquet.read_table(path)
    told = read_by_gdal(path, driver, *columns)
    assert (told["driver"], told["type"], told["count"]) == ("Parquet", kind, len(table))
    assert told["crs"] in ("EPSG:4326", "OGC:CRS84")
    assert set(told["fields"]) == set(table.column_names) - {"geometry"}
    shapes = [None if shape is None else shapely.from_wkb(bytes.fromhex(shape)) for shape in told["shapes"]]
    ours = [None if shape is None else shapely.from_wkb(shape) for shape in table["geometry"].to_pylist()]
    assert shapes == ours
    assert any(shape is not None for shape in shapes)
    for name in columns:
        assert told["columns"][name] == table[name].to_pylist(), name
