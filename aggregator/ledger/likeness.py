"""What in a file is like a ledger: the rows that a cell of a page can be, and whether there is any such row at all."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

from aggregator.ledger.pages import HEADER_BYTES, LEAF, Cell, NoCell, Pages, pages_of
from aggregator.ledger.schema import APPLICATION_ID, TABLES, Table

Row = tuple[Any, ...]
"""A row's columns in the order of its table, its checksum last."""
MAGIC = b"SQLite format 3\0"
"""What every SQLite file begins with."""
MOST_LOOKED_AT = 20_000
"""Pages whose first byte is looked at, spread over the file: 0.2 s."""
MOST_WITHOUT_ROW = 500
"""Pages of those that say that they hold rows: where none of so many holds one of a ledger's this is none."""

_ID_AT = 68
"""Where an SQLite file has its application id."""
_KINDS: dict[str, tuple[type, ...]] = {"TEXT": (str,), "INTEGER": (int,), "REAL": (float, int), "BLOB": (bytes,)}


def begins_as_sqlite(path: Path) -> bool:
    """Whether the file begins as SQLite files do; what follows may be damaged."""
    with path.open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC


def may_be_ledger(path: Path) -> bool:
    """Whether the file, or its write-ahead log, has the header of a ledger or any row of one, damaged or not.

    Takes a second at most, however large the file is; a ledger whose first pages are gone is known by its others.
    """
    with pages_of(path) as moments:
        return any(_has_header(pages) or _has_row(pages) for pages in moments)


def no_ledger(path: Path) -> str:
    """What is said of a file that is no ledger, and what to give instead."""
    begins = (
        "it is an SQLite file of another program" if begins_as_sqlite(path) else "it does not begin as SQLite files do"
    )
    return f"{path} is no ledger: {begins}, and no row of one is in it; give a run's folder or its ledger.db"


def _has_header(pages: Pages) -> bool:
    first = pages.page(1)
    return first is not None and first.startswith(MAGIC) and first[_ID_AT : _ID_AT + 4] == APPLICATION_ID.to_bytes(4)


def _has_row(pages: Pages) -> bool:
    return any(
        fitting(pages, page, at)
        for page, begin in islice(_leaves(pages), MOST_WITHOUT_ROW)
        for at in _cells(page, begin)
    )


def _leaves(pages: Pages) -> Iterator[tuple[bytes, int]]:
    """(page, where its header begins) of those of the log, and of some of the file, that say that they hold rows."""
    last = len(pages.file) // pages.size
    step = max(1, -(-last // MOST_LOOKED_AT))
    for number in (*sorted(pages.log), *range(1, last + 1, step)):
        begin = HEADER_BYTES if number == 1 else 0
        at = (number - 1) * pages.size + begin
        kind = pages.log[number][begin] if number in pages.log else pages.file[at]
        if kind == LEAF and (page := pages.page(number)) is not None:
            yield page, begin


def _cells(page: bytes, begin: int) -> list[int]:
    """Where the cells of a page begin by its header; none where that is no header of a page."""
    (count,) = struct.unpack_from(">H", page, begin + 3)
    first = begin + 8
    if first + 2 * count > len(page):
        return []
    return list(struct.unpack_from(f">{count}H", page, first))


def fitting(pages: Pages, page: bytes, at: int) -> list[tuple[Table, Row]]:
    """The rows that the cell there can be by the number and the types of its columns; none where there is no cell."""
    try:
        return list(_as_rows(pages.cell(page, at)))
    except (NoCell, IndexError, struct.error):
        return []


def _as_rows(cell: Cell) -> Iterator[tuple[Table, Row]]:
    """The rows that a cell can be by the number and the types of its columns."""
    for table in TABLES:
        for order in _orders(table):
            if len(order) != len(cell.values):
                continue
            values = dict(zip(order, cell.values, strict=True))
            named: list[Any] = []
            for name, kind in table.columns:
                value = values.get(name)
                if value is None and table.key == name and kind.startswith("INTEGER"):
                    value = cell.rowid  # SQLite keeps such a key as the row's number
                if value is None and "NOT NULL" in kind:
                    break
                if value is not None and not isinstance(value, _KINDS[kind.split()[0]]):
                    break
                named.append(float(value) if kind.startswith("REAL") and isinstance(value, int) else value)
            else:
                if isinstance(values["crc"], int):
                    yield table, (*named, values["crc"])


def _orders(table: Table) -> list[tuple[str, ...]]:
    """Columns of a table as they lie in its rows: as it is made now, or as it came to be with columns added later."""
    orders = [(*table.names, "crc")]
    if table.added:
        later = dict(table.added)
        first = tuple(name for name in table.names if name not in later)
        orders += [(*first, "crc"), (*first, "crc", *later)]
    return orders
