"""Cells of a field's map as a table with areas."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from tuberline.export.table import Column, Ring, Table
from tuberline.export.tubers import about
from tuberline.maps.field import FieldMap

CELL_COLUMNS = (
    Column("lat_deg", "number", "deg", "middle of the cell, WGS84"),
    Column("lon_deg", "number", "deg", "middle of the cell, WGS84"),
    Column("t_ha", "number", "t/ha", "yield of the cell's lifted ground"),
    Column("low_t_ha", "number", "t/ha", "lower end of the cell's own 90 % interval"),
    Column("high_t_ha", "number", "t/ha", "upper end of the cell's own 90 % interval"),
    Column("kg", "number", "kg", "calibrated, made up for belt that was not seen"),
    Column("area_m2", "number", "m2", "lifted ground in the cell"),
    Column("tubers", "number", "", "counted; seconds that lie in two cells are shared"),
)


def cells_table(runs: Sequence[Path], field: FieldMap) -> Table:
    """One row per known cell, with its square as longitudes and latitudes."""
    cells = field.cells
    known = np.isfinite(cells.t_ha)
    centres = cells.centres_m()[known]
    middle_lat, middle_lon = field.plane.to_degrees(centres)
    columns = (cells.t_ha, cells.low_t_ha, cells.high_t_ha, cells.kg, cells.area_m2, cells.count)
    values = [middle_lat, middle_lon, *(column[known] for column in columns)]
    rows = list(zip(*(column.tolist() for column in values), strict=True))
    told = {**about(runs), "mean_t_ha": cells.mean_t_ha, "shared_percent": cells.shared_percent}
    polygons = [cut_at_180([(float(x), float(y)) for x, y in ring]) for ring in field.squares()]
    return Table("cells", CELL_COLUMNS, rows, told, polygons)


def cut_at_180(ring: Ring) -> list[Ring]:
    """A convex ring as RFC 7946 (3.1.9) has it: where it crosses the 180th meridian, its parts on either side; else a
    program takes it the other way, around the Earth.
    """
    lons = [lon for lon, _ in ring]
    if max(lons) - min(lons) <= 180 and min(lons) >= -180 and max(lons) <= 180:
        return [ring]
    eastward = [(lon % 360, lat) for lon, lat in ring]
    west, east = (_part(eastward, side) for side in (-1, 1))
    parts = [west, [(lon - 360, lat) for lon, lat in east]]
    return [part for part in parts if len(part) > 3]  # one that only touches it has no area beyond


def _part(ring: Ring, side: int) -> Ring:
    """What of a ring lies west (-1) or east (1) of 180 degrees."""
    kept: list[tuple[float, float]] = []
    for (lon, lat), (to_lon, to_lat) in pairwise(ring):
        if side * (lon - 180) >= 0:
            kept.append((lon, lat))
        if (lon - 180) * (to_lon - 180) < 0:
            kept.append((180.0, lat + (to_lat - lat) * (180 - lon) / (to_lon - lon)))
    return [*kept, *kept[:1]]
