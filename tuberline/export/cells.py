"""Cells of a field's map as a table with areas."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tuberline.export.table import Column, Table
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
    half = cells.cell_m / 2
    corners = centres[:, None] + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * half
    lat, lon = field.plane.to_degrees(corners.reshape(-1, 2))
    rings = np.stack([lon, lat], axis=1).reshape(-1, 5, 2)
    middle_lat, middle_lon = field.plane.to_degrees(centres)
    columns = (cells.t_ha, cells.low_t_ha, cells.high_t_ha, cells.kg, cells.area_m2, cells.count)
    values = [middle_lat, middle_lon, *(column[known] for column in columns)]
    rows = list(zip(*(column.tolist() for column in values), strict=True))
    told = {**about(runs), "mean_t_ha": cells.mean_t_ha, "shared_percent": cells.shared_percent}
    polygons = [[(float(x), float(y)) for x, y in ring] for ring in rings]
    return Table("cells", CELL_COLUMNS, rows, told, polygons)
