"""Tables as CSV and GeoJSON."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

from tuberline.export.table import Table

_CSVW = {"text": "string", "whole": "integer", "number": "number", "time": "datetime"}


def write_csv(table: Table, path: Path) -> int:
    """The rows, and beside them NAME.csv-metadata.json: names, units and meanings by the W3C's CSV on the Web.

    Returns how many rows there are.
    """
    rows = 0
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([column.name for column in table.columns])
        for row in table.rows:
            writer.writerow(row)
            rows += 1
    told = {
        "@context": ["http://www.w3.org/ns/csvw", {"@language": "en"}],
        "url": path.name,
        "tableSchema": {
            "columns": [
                {
                    "name": column.name,
                    "titles": column.name,
                    "datatype": _CSVW[column.kind],
                    "dc:description": column.about,
                    **({"schema:unitText": column.unit} if column.unit else {}),
                }
                for column in table.columns
            ]
        },
        "dc:description": table.about,
    }
    path.with_name(f"{path.name}-metadata.json").write_text(json.dumps(told, indent=1) + "\n")
    return rows


def write_geojson(table: Table, path: Path) -> int:
    """A FeatureCollection (RFC 7946); rows without a place have no geometry. `about` and `units` stand beside it.

    Returns how many features there are. They come last and are written one by one.
    """
    told = {
        "type": "FeatureCollection",
        "name": table.name,
        "about": table.about,
        "units": {column.name: column.unit for column in table.columns if column.unit},
    }
    names, rows = [column.name for column in table.columns], 0
    with path.open("w") as file:
        file.write(f'{json.dumps(told)[:-1]}, "features": [')
        for n, row in enumerate(table.rows):
            values = dict(zip(names, row, strict=True))
            feature = {"type": "Feature", "geometry": _geometry(table, n, values), "properties": values}
            file.write(f"{', ' if n else ''}{json.dumps(feature)}")
            rows += 1
        file.write("]}\n")
    return rows


def _geometry(table: Table, n: int, values: dict[str, Any]) -> dict[str, Any] | None:
    if table.polygons is not None:
        first, *more = parts = [[ring] for ring in table.polygons[n]]
        return {"type": "MultiPolygon", "coordinates": parts} if more else {"type": "Polygon", "coordinates": first}
    lat, lon = values.pop("lat_deg"), values.pop("lon_deg")
    return None if lat is None else {"type": "Point", "coordinates": [lon, lat]}
