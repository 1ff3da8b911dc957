"""A table with names, units and meanings, and what is to be known of all its rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

Ring = Sequence[tuple[float, float]]
"""Longitudes and latitudes, the first point once more at the end."""


@dataclass(frozen=True, slots=True)
class Column:
    """One column: `kind` is 'text', 'whole', 'number' or 'time' (ISO 8601, UTC); `unit` '' where it has none."""

    name: str
    kind: str
    unit: str
    about: str


@dataclass(frozen=True, slots=True)
class Table:
    """Rows in the order of `columns`; `polygons` are the areas of the rows, where they have one: a ring each, or one on
    either side of the 180th meridian.

    Attributes:
        name: 'tubers', 'loads' or 'cells'.
        about: what holds for all rows: runs, weights, calibration, coverage, version; plain values.
    """

    name: str
    columns: tuple[Column, ...]
    rows: Sequence[tuple[Any, ...]]
    about: dict[str, Any]
    polygons: Sequence[Sequence[Ring]] | None = None

    def column(self, name: str) -> list[Any]:
        """All values of one column."""
        at = [column.name for column in self.columns].index(name)
        return [row[at] for row in self.rows]
