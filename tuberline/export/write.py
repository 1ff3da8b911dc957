"""Which file of which format holds what."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from enum import StrEnum
from pathlib import Path

from conveyor.errors import InputError
from conveyor.files import whole_output
from conveyor.messages import Tuber
from tuberline.export.cells import cells_table
from tuberline.export.table import Table
from tuberline.export.tubers import about, loads_table, tubers_table
from tuberline.maps.field import FieldMap, FieldPlaces


class Format(StrEnum):
    """A file format, named as the command names it."""

    CSV = "csv"
    PARQUET = "parquet"
    GEOJSON = "geojson"
    GEOPARQUET = "geoparquet"
    ISOXML = "isoxml"
    XLSX = "xlsx"
    HTML = "html"
    PDF = "pdf"


REPORTS = (Format.HTML, Format.PDF)
ENDINGS = {Format.GEOPARQUET: "parquet", Format.ISOXML: "zip"}
NEED_PLACES = (Format.GEOJSON, Format.GEOPARQUET, Format.ISOXML)


def export(
    runs: Sequence[Path],
    out: Path,
    *,
    form: Format,
    what: str,
    field: FieldPlaces | None,
    tubers: Sequence[Iterable[Tuber]] = (),
) -> int:
    """Write `out`, whole or not at all; returns the rows written.

    Args:
        what: 'tubers', 'loads' or 'cells'; ISOXML holds the map's seconds, a workbook tubers and loads.
        field: where positions are known; for cells the map. tubers: those of each run, for rows that are tubers.

    Raises:
        InputError: the format needs places and none are known, or a package for it is not installed.
    """
    if what == "loads" and form in NEED_PLACES:
        raise InputError(f"{form.value} holds places, loads have none: export tubers or cells, or choose csv")
    if field is None and (form in NEED_PLACES or what == "cells"):
        wanted = "a map" if what == "cells" else form.value
        raise InputError(f"{wanted} needs to know where the machine was: give --track FILE")
    if form is Format.ISOXML:
        from tuberline.export.isoxml.task_data import write_taskdata

        assert field is not None
        with whole_output(out) as path:
            return write_taskdata(field, path, about=about(runs))
    table = _table(runs, what, field, tubers)
    with whole_output(out) as path:
        return _write(table, runs, path, form)


def _table(runs: Sequence[Path], what: str, field: FieldPlaces | None, tubers: Sequence[Iterable[Tuber]]) -> Table:
    if what == "cells" and isinstance(field, FieldMap):
        return cells_table(runs, field)
    return loads_table(runs) if what == "loads" else tubers_table(runs, field, tubers)


def _write(table: Table, runs: Sequence[Path], path: Path, form: Format) -> int:
    """How many rows were written."""
    if form is Format.CSV:
        from tuberline.export.text_files import write_csv

        return write_csv(table, path)
    if form is Format.GEOJSON:
        from tuberline.export.text_files import write_geojson

        return write_geojson(table, path)
    if form is Format.XLSX:
        from tuberline.export.binary_files import write_xlsx

        return write_xlsx([table] if table.name == "loads" else [table, loads_table(runs)], path)
    from tuberline.export.binary_files import write_parquet

    return write_parquet(table, path, geometry=form is Format.GEOPARQUET)
