"""Tables as Parquet, GeoParquet and Excel workbooks."""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

from conveyor.errors import InputError
from conveyor.extras import install_hint
from tuberline.export.table import Table

GEOPARQUET_VERSION = "1.1.0"


def write_parquet(table: Table, path: Path, *, geometry: bool = False) -> None:
    """Apache Parquet; units and meanings in each field's metadata, the rest under 'tuberline' in the file's.

    `geometry`: as GeoParquet, points or squares as WKB in longitude and latitude.

    Raises:
        InputError: pyarrow is not installed.
    """
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError as error:
        raise InputError(f"Parquet needs pyarrow, which is not installed; {install_hint('files')}") from error
    kinds = {"text": pa.string(), "whole": pa.int64(), "number": pa.float64(), "time": pa.timestamp("ms", tz="UTC")}
    fields, arrays = [], []
    for n, column in enumerate(table.columns):
        values = [row[n] for row in table.rows]
        kind = kinds[column.kind]
        if column.kind == "time":
            array = pa.array([value.rstrip("Z") for value in values]).cast(pa.timestamp("ms")).cast(kind)
        else:
            array = pa.array(values, type=kind)
        fields.append(pa.field(column.name, kind, metadata={"unit": column.unit, "about": column.about}))
        arrays.append(array)
    told: dict[str, str] = {"tuberline": json.dumps(table.about)}
    if geometry:
        shapes = _shapes(table)
        fields.append(pa.field("geometry", pa.binary()))
        arrays.append(pa.array([None if shape is None else _wkb(shape) for shape in shapes], type=pa.binary()))
        told["geo"] = json.dumps(_geo(shapes))
    made = pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata=told))
    # Packed in memory, as a workbook is: what a full disk says is then Python's own word, and one sentence.
    packed = BytesIO()
    parquet.write_table(made, packed, compression="zstd")
    path.write_bytes(packed.getvalue())


def write_xlsx(tables: Sequence[Table], path: Path) -> None:
    """A workbook: a sheet per table with its units in the second row, and one that says what it is.

    Raises:
        InputError: xlsxwriter is not installed, or a table has more rows than a sheet holds.
    """
    try:
        import xlsxwriter
    except ImportError as error:
        raise InputError(f"Excel files need xlsxwriter, which is not installed; {install_hint('files')}") from error
    for table in tables:
        if len(table.rows) > 1_048_573:
            raise InputError(
                f"{len(table.rows)} {table.name} do not fit a sheet (1,048,573 rows): export parquet or csv"
            )
    # Packed in memory: its own faults of a full disk are no OSError, and its zip is left open.
    packed = BytesIO()
    # Text stays text: a run's name that begins with '=' is no formula.
    with xlsxwriter.Workbook(packed, {"strings_to_formulas": False, "strings_to_urls": False}) as book:
        head = book.add_format({"bold": True, "bottom": 1})
        quiet = book.add_format({"italic": True, "font_color": "#666666"})
        for table in tables:
            sheet = book.add_worksheet(table.name)
            sheet.freeze_panes(2, 0)
            for n, column in enumerate(table.columns):
                sheet.write(0, n, column.name, head)
                sheet.write(1, n, column.unit, quiet)
                sheet.set_column(n, n, max(10, len(column.name) + 2))
            for at, row in enumerate(table.rows, start=2):
                for n, value in enumerate(row):
                    if value is not None:
                        sheet.write(at, n, value)
        about = book.add_worksheet("about")
        about.set_column(0, 0, 26)
        about.set_column(1, 1, 80)
        lines = [
            *_flat(tables[0].about),
            *((f"{t.name}.{c.name}", f"{c.about} [{c.unit}]") for t in tables for c in t.columns),
        ]
        for at, (name, value) in enumerate(lines):
            about.write(at, 0, name)
            about.write(at, 1, value)
    path.write_bytes(packed.getvalue())


def _shapes(table: Table) -> list[Any]:
    """Of each row its point, its area (a list of rings), or None."""
    if table.polygons is not None:
        return list(table.polygons)
    pairs = zip(table.column("lon_deg"), table.column("lat_deg"), strict=True)
    return [None if lon is None else (lon, lat) for lon, lat in pairs]


def _kind(shape: Any) -> str:
    if isinstance(shape, tuple):
        return "Point"
    return "MultiPolygon" if len(shape) > 1 else "Polygon"


def _wkb(shape: Any) -> bytes:
    """A point, a polygon or several, each of one ring, as well-known binary, little-endian."""
    match _kind(shape):
        case "Point":
            return struct.pack("<BIdd", 1, 1, *shape)
        case "Polygon":
            (ring,) = shape
            values = (value for point in ring for value in point)
            return struct.pack(f"<BIII{2 * len(ring)}d", 1, 3, 1, len(ring), *values)
        case _:
            return struct.pack("<BII", 1, 6, len(shape)) + b"".join(_wkb([ring]) for ring in shape)


def _geo(shapes: Sequence[Any]) -> dict[str, Any]:
    known = [shape for shape in shapes if shape is not None]
    kinds = sorted({_kind(shape) for shape in known}) or ["Point"]
    column: dict[str, Any] = {"encoding": "WKB", "geometry_types": kinds}
    points = [p for s in known for p in ([s] if isinstance(s, tuple) else [p for ring in s for p in ring])]
    if points:
        lons, lats = zip(*points, strict=True)
        west, east = _west_and_east(lons)
        column["bbox"] = [west, min(lats), east, max(lats)]
    return {"version": GEOPARQUET_VERSION, "primary_column": "geometry", "columns": {"geometry": column}}


def _west_and_east(lons: Sequence[float]) -> tuple[float, float]:
    """Bounds of a field; west is the larger one of a field that lies on the 180th meridian (RFC 7946, 5.2)."""
    if max(lons) - min(lons) <= 180:
        return min(lons), max(lons)
    return min(lon for lon in lons if lon > 0), max(lon for lon in lons if lon < 0)


def _flat(values: Any, name: str = "") -> list[tuple[str, str]]:
    """Nested plain values as lines 'a.b.c', value."""
    if isinstance(values, dict):
        return [line for key, value in values.items() for line in _flat(value, f"{name}.{key}".lstrip("."))]
    if isinstance(values, list) and any(isinstance(value, dict) for value in values):
        return [line for n, value in enumerate(values) for line in _flat(value, f"{name}[{n}]")]
    return [(name, ", ".join(map(str, values)) if isinstance(values, list) else str(values))]
