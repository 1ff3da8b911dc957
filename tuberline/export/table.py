"""A table with names, units and meanings, and what is to be known of all its rows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, TypeVar

T = TypeVar("T")
BATCH = 4096
"""Rows that are in memory at once, where it takes several to be quick."""
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
    """Rows in the order of `columns`, each as it is asked for, so that they need not be in memory.

    `polygons` are the areas of the rows, where they have one: a ring each, or one on either side of the 180th meridian.

    Attributes:
        name: 'tubers', 'loads' or 'cells'.
        about: what holds for all rows: runs, weights, calibration, coverage, version; plain values.
    """

    name: str
    columns: tuple[Column, ...]
    rows: Iterable[tuple[Any, ...]]
    about: dict[str, Any]
    polygons: Sequence[Sequence[Ring]] | None = None


def in_batches(rows: Iterable[T]) -> Iterator[list[T]]:
    """All of `rows` in order, `BATCH` at a time; the last ones may be fewer."""
    left = iter(rows)
    while batch := list(islice(left, BATCH)):
        yield batch
