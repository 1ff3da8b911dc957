"""The field's map for browsers: cells that somebody computes of the open run, and the machine's way as it is told."""

from __future__ import annotations

import json
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from viewer.way import Way

TELL_EVERY = 20
"""Places after which browsers are told that the way has grown."""
NO_FIX, NOT_COMPUTED = "no_fix", "not_computed"
"""Why there are no cells: the receiver tells no place, or no process computes them for this page."""


@dataclass(slots=True)
class _Field:
    number: int = 0
    cells: Sequence[Mapping[str, Any]] = ()
    about: Mapping[str, float] = field(default_factory=dict)
    way: Way = field(default_factory=Way)
    not_told: int = 0
    why: tuple[str, str] = (NOT_COMPUTED, "")
    fixless: bool = False

    @property
    def why_no_cells(self) -> tuple[str, str]:
        """(a word, a text): both empty where there are cells, or nothing is known yet."""
        if self.cells:
            return "", ""
        return (NO_FIX, "") if self.fixless and not self.way.lon_lat else self.why


class FieldMaps:
    """One map per line; from any thread. `number` rises when there is something new to fetch, and is 0 before that."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._fields: dict[str, _Field] = {}

    def begin(self, line: str) -> None:
        """Another run has begun: of its field nothing is known yet."""
        with self._lock:
            if line in self._fields:
                before = self._fields[line]
                self._fields[line] = _Field(number=before.number + 1, why=before.why)

    def put_cells(self, line: str, cells: Sequence[Mapping[str, Any]], about: Mapping[str, float]) -> None:
        """The cells as GeoJSON features, and what is told of all of them (`low`, `high`, `mean`, t/ha)."""
        with self._lock:
            found = self._fields.setdefault(line, _Field())
            found.cells, found.about, found.number, found.why = cells, about, found.number + 1, ("", "")

    def tell_why(self, line: str, why: str, text: str) -> None:
        """Why the process that computes the cells has none: a word that the page has words for, or '', and a text."""
        with self._lock:
            found = self._fields.setdefault(line, _Field())
            if found.why != (why, text):
                found.why, found.number = (why, text), found.number + 1

    def no_fix(self, line: str) -> None:
        """The receiver is there and tells no place."""
        with self._lock:
            found = self._fields.setdefault(line, _Field())
            if not found.fixless:
                found.fixless, found.number = True, found.number + 1

    def add_place(self, line: str, *, lat_deg: float, lon_deg: float) -> None:
        """Where the machine is now."""
        with self._lock:
            found = self._fields.setdefault(line, _Field())
            if not found.way.add(lat_deg=lat_deg, lon_deg=lon_deg):
                return
            found.not_told += 1
            if found.not_told >= TELL_EVERY or len(found.way.lon_lat) == 2:
                found.number, found.not_told = found.number + 1, 0

    def number(self, line: str) -> int:
        """Of the newest map of this line."""
        with self._lock:
            return self._fields[line].number if line in self._fields else 0

    def newest(self, line: str) -> bytes:
        """The map as JSON: {number, cells (a FeatureCollection), about, way ([lon, lat], oldest first), why, said}.

        `why` and `said`: a word and a text, why there are no cells.
        """
        with self._lock:
            found = self._fields.get(line, _Field())
            way = [[round(lon, 7), round(lat, 7)] for lon, lat in found.way.lon_lat]
            cells = {"type": "FeatureCollection", "features": list(found.cells)}
            why, said = found.why_no_cells
            told = {"number": found.number, "cells": cells, "about": dict(found.about), "way": way}
            told |= {"why": why, "said": said}
        return json.dumps(told, separators=(",", ":"), allow_nan=False).encode()
