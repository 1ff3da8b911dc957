"""The field's map for browsers: cells that somebody computes of the open run, and the machine's way as it is told."""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

MOST_PLACES = 4000
STEP_M = 1.0
TELL_EVERY = 20
"""Places after which browsers are told that the way has grown."""
M_PER_DEG = 111_320.0


@dataclass(slots=True)
class _Field:
    number: int = 0
    cells: Sequence[Mapping[str, Any]] = ()
    about: Mapping[str, float] = field(default_factory=dict)
    way: list[tuple[float, float]] = field(default_factory=list)
    untold: int = 0


class FieldMaps:
    """One map per line; from any thread. `number` rises when there is something new to fetch, and is 0 before that."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._fields: dict[str, _Field] = {}

    def put_cells(self, line: str, cells: Sequence[Mapping[str, Any]], about: Mapping[str, float]) -> None:
        """The cells as GeoJSON features, and what is told of all of them (`low`, `high`, `mean`, t/ha)."""
        with self._lock:
            found = self._fields.setdefault(line, _Field())
            found.cells, found.about, found.number = cells, about, found.number + 1

    def add_place(self, line: str, *, lat_deg: float, lon_deg: float) -> None:
        """Where the machine is now; steps of less than `STEP_M` are left out, an old way keeps every second one."""
        with self._lock:
            found = self._fields.setdefault(line, _Field())
            if found.way and _metres(found.way[-1], (lon_deg, lat_deg)) < STEP_M:
                return
            found.way.append((lon_deg, lat_deg))
            if len(found.way) > MOST_PLACES:
                found.way = found.way[:-1:2] + found.way[-1:]
            found.untold += 1
            if found.untold >= TELL_EVERY or len(found.way) == 2:
                found.number, found.untold = found.number + 1, 0

    def number(self, line: str) -> int:
        """Of the newest map of this line."""
        with self._lock:
            return self._fields[line].number if line in self._fields else 0

    def newest(self, line: str) -> bytes:
        """The map as JSON: {number, cells (a FeatureCollection), about, way ([lon, lat], oldest first)}."""
        with self._lock:
            found = self._fields.get(line, _Field())
            way = [[round(lon, 7), round(lat, 7)] for lon, lat in found.way]
            cells = {"type": "FeatureCollection", "features": list(found.cells)}
            told = {"number": found.number, "cells": cells, "about": dict(found.about), "way": way}
        return json.dumps(told, separators=(",", ":"), allow_nan=False).encode()


def _metres(a: tuple[float, float], b: tuple[float, float]) -> float:
    """Between two places (lon, lat) that are near each other."""
    east = (a[0] - b[0]) * math.cos(math.radians(a[1])) * M_PER_DEG
    return math.hypot(east, (a[1] - b[1]) * M_PER_DEG)
