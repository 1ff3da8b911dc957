"""Tables as Parquet, GeoParquet and Excel workbooks."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

from conveyor.errors import InputError
from conveyor.extras import install_hint
from tuberline.export.geometry import Shapes, shapes_of
from tuberline.export.table import Table, in_batches

MOST_ROWS = 1_048_573
"""Of a sheet, below names and units."""


def write_parquet(table: Table, path: Path, *, geometry: bool = False) -> int:
    """Apache Parquet; units and meanings in each field's metadata, the rest under 'tuberline' in the file's.

    `geometry`: as GeoParquet, points or squares as WKB in longitude and latitude. Returns how many rows there are.
    Rows are held as packed columns, for the file is made of groups of a million of them.

    Raises:
        InputError: pyarrow is not installed.
    """
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError as error:
        raise InputError(f"Parquet needs pyarrow, which is not installed; {install_hint('files')}") from error
    kinds = {"text": pa.string(), "whole": pa.int64(), "number": pa.float64(), "time": pa.timestamp("ms", tz="UTC")}
    fields = [
        pa.field(column.name, kinds[column.kind], metadata={"unit": column.unit, "about": column.about})
        for column in table.columns
    ]
    told: dict[str, str] = {"tuberline": json.dumps(table.about)}
    columns, shapes = _packed(table, kinds, geometry=geometry)
    if geometry:
        fields.append(pa.field("geometry", pa.binary()))
        told["geo"] = json.dumps(shapes.told())
    joined = [
        pa.concat_arrays(parts) if parts else pa.array([], field.type)
        for parts, field in zip(columns, fields, strict=True)
    ]
    made = pa.Table.from_arrays(joined, schema=pa.schema(fields, metadata=told))
    # Packed in memory, as a workbook is: what a full disk says is then Python's own word, and one sentence.
    packed = BytesIO()
    parquet.write_table(made, packed, compression="zstd")
    path.write_bytes(packed.getbuffer())
    return int(made.num_rows)


def _packed(table: Table, kinds: Mapping[str, Any], *, geometry: bool) -> tuple[list[list[Any]], Shapes]:
    """(arrays of each column, one a batch of rows, the geometry's last where it is asked for; what its shapes are)."""
    import pyarrow as pa

    columns: list[list[Any]] = [[] for _ in range(len(table.columns) + geometry)]
    shapes, first = Shapes(), 0
    for batch in in_batches(table.rows):
        for n, column in enumerate(table.columns):
            values = [row[n] for row in batch]
            kind = kinds[column.kind]
            if column.kind == "time":
                array = pa.array([value.rstrip("Z") for value in values]).cast(pa.timestamp("ms")).cast(kind)
            else:
                array = pa.array(values, type=kind)
            columns[n].append(array)
        if geometry:
            found = [shapes.add(shape) for shape in shapes_of(table, batch, first)]
            columns[-1].append(pa.array(found, type=pa.binary()))
        first += len(batch)
    return columns, shapes


def write_xlsx(tables: Sequence[Table], path: Path) -> int:
    """A workbook: a sheet per table with its units in the second row, and one that says what it is.

    Returns how many rows the first sheet holds. All cells are held in memory until it is written: its texts stand once
    in a list that comes before them.

    Raises:
        InputError: xlsxwriter is not installed, or a table has more rows than a sheet holds.
    """
    try:
        import xlsxwriter
    except ImportError as error:
        raise InputError(f"Excel files need xlsxwriter, which is not installed; {install_hint('files')}") from error
    # Packed in memory: its own faults of a full disk are no OSError, and its zip is left open.
    packed, rows = BytesIO(), list[int]()
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
            rows.append(_fill(sheet, table))
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
    path.write_bytes(packed.getbuffer())
    return rows[0]


def _fill(sheet: Any, table: Table) -> int:
    """Write the rows below names and units; how many there are."""
    rows = 0
    for row in table.rows:
        if rows == MOST_ROWS:
            raise InputError(f"more than {MOST_ROWS:,} {table.name} do not fit a sheet: export parquet or csv")
        for n, value in enumerate(row):
            if value is not None:
                sheet.write(rows + 2, n, value)
        rows += 1
    return rows


def _flat(values: Any, name: str = "") -> list[tuple[str, str]]:
    """Nested plain values as lines 'a.b.c', value."""
    if isinstance(values, dict):
        return [line for key, value in values.items() for line in _flat(value, f"{name}.{key}".lstrip("."))]
    if isinstance(values, list) and any(isinstance(value, dict) for value in values):
        return [line for n, value in enumerate(values) for line in _flat(value, f"{name}[{n}]")]
    return [(name, ", ".join(map(str, values)) if isinstance(values, list) else str(values))]
