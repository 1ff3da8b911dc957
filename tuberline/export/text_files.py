"""Tables as CSV and GeoJSON."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

from tuberline.export.table import Table

_CSVW = {"text": "string", "whole": "integer", "number": "number", "time": "datetime"}


def write_csv(table: Table, path: Path) -> None:
    """The rows, and beside them NAME.csv-metadata.json: names, units and meanings by the W3C's CSV on the Web."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([column.name for column in table.columns])
        writer.writerows(table.rows)
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


def write_geojson(table: Table, path: Path) -> None:
    """A FeatureCollection (RFC 7946); rows without a place have no geometry. `about` and `units` stand beside it."""
    names = [column.name for column in table.columns]
    features = []
    for n, row in enumerate(table.rows):
        values = dict(zip(names, row, strict=True))
        features.append({"type": "Feature", "geometry": _geometry(table, n, values), "properties": values})
    told = {
        "type": "FeatureCollection",
        "name": table.name,
        "about": table.about,
        "units": {column.name: column.unit for column in table.columns if column.unit},
        "features": features,
    }
    path.write_text(json.dumps(told) + "\n")


def _geometry(table: Table, n: int, values: dict[str, Any]) -> dict[str, Any] | None:
    if table.polygons is not None:
        first, *more = parts = [[ring] for ring in table.polygons[n]]
        return {"type": "MultiPolygon", "coordinates": parts} if more else {"type": "Polygon", "coordinates": first}
    lat, lon = values.pop("lat_deg"), values.pop("lon_deg")
    return None if lat is None else {"type": "Point", "coordinates": [lon, lat]}
