"""Points and squares as GeoParquet has them: well-known binary, and what is told of all of them."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import Any

from tuberline.export.table import Table

GEOPARQUET_VERSION = "1.1.0"


def shapes_of(table: Table, rows: Sequence[tuple[Any, ...]], first: int) -> list[Any]:
    """Of each of `rows`, the first of which is number `first` of its table: its point (longitude, latitude), its area
    (a list of rings), or None.
    """
    if table.polygons is not None:
        return list(table.polygons[first : first + len(rows)])
    names = [column.name for column in table.columns]
    lon, lat = names.index("lon_deg"), names.index("lat_deg")
    return [None if row[lon] is None else (row[lon], row[lat]) for row in rows]


class Shapes:
    """Shapes one after the other; what holds for all of them so far."""

    def __init__(self) -> None:
        self._kinds: set[str] = set()
        self._lon = _Range()
        self._lat = _Range()
        self._east, self._west = _Range(), _Range()  # of longitudes above and below zero

    def add(self, shape: Any) -> bytes | None:
        """As well-known binary; None where there is none."""
        if shape is None:
            return None
        self._kinds.add(_kind(shape))
        for lon, lat in [shape] if isinstance(shape, tuple) else (point for ring in shape for point in ring):
            self._lon.take(lon)
            self._lat.take(lat)
            if lon:
                (self._east if lon > 0 else self._west).take(lon)
        return _wkb(shape)

    def told(self) -> dict[str, Any]:
        """The metadata 'geo' of a GeoParquet file."""
        column: dict[str, Any] = {"encoding": "WKB", "geometry_types": sorted(self._kinds) or ["Point"]}
        if self._kinds:
            west, east = self._west_and_east()
            column["bbox"] = [west, self._lat.low, east, self._lat.high]
        return {"version": GEOPARQUET_VERSION, "primary_column": "geometry", "columns": {"geometry": column}}

    def _west_and_east(self) -> tuple[float, float]:
        """Bounds of a field; west is the larger one of a field that lies on the 180th meridian (RFC 7946, 5.2)."""
        if self._lon.high - self._lon.low <= 180:
            return self._lon.low, self._lon.high
        return self._east.low, self._west.high


class _Range:
    """The least and the most of what was taken."""

    def __init__(self) -> None:
        self.low, self.high = math.inf, -math.inf

    def take(self, value: float) -> None:
        self.low, self.high = min(self.low, value), max(self.high, value)


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
