"""Every row of a damaged ledger that is as it was written, wherever it lies, and rows of which one bit was flipped.

A row's checksum tells of itself alone that it is intact, so rows are taken from all pages, whether SQLite still finds
its way to them or not. CRC-32 differs for any three flipped bits of a row of up to 11 kB: where putting back a single
one makes the checksum right, the row is as it was.
"""

from __future__ import annotations

import sqlite3
import struct
import zlib
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgpack

from aggregator.ledger.faults import DAMAGE
from aggregator.ledger.likeness import Row, fitting
from aggregator.ledger.pages import LEAF, MOST_BYTES, NoCell, Pages, pages_of
from aggregator.ledger.schema import MOVING, OLDEST_VERSION, SCHEMA_VERSION, TABLES, Table, checksum, packed
from aggregator.ledger.verified import named_key

SMALL_BYTES = 600
"""A row of so many bytes in its page is tried bit by bit, of a larger one the first `HEAD_BYTES`, and its values."""
HEAD_BYTES = 120
MOST_TRIED = 200
"""Damaged rows that are tried so, at 0.1 s each: more are no flipped bits."""

_POLYNOMIAL = 0xEDB88320


@dataclass(slots=True)
class Salvaged:
    """What a damaged ledger still holds.

    Attributes:
        rows: by table, sorted by key; of tables whose rows move on, the newest step.
        righted: rows of which one bit was put back, in words.
        damaged: by table, the rows that are there and are not as they were written, without checksum.
        unread: tables that SQLite could not read to their end, in words.
        version: of its schema; this program's where the file does not say.
    """

    rows: dict[str, list[Row]]
    version: int = SCHEMA_VERSION
    righted: list[str] = field(default_factory=list)
    damaged: dict[str, list[Row]] = field(default_factory=dict)
    unread: list[str] = field(default_factory=list)


class _Found:
    """Rows by table and key."""

    def __init__(self) -> None:
        self.good: dict[str, dict[Row, Row]] = {table.name: {} for table in TABLES}

    def add(self, table: Table, found: Row) -> bool:
        """Whether that was a row that was not known."""
        known, key = self.good[table.name], key_of(table, found)
        if key in known and (table not in MOVING or known[key][_step(table)] >= found[_step(table)]):
            return False
        known[key] = found
        return True


def key_of(table: Table, found: Sequence[Any]) -> Row:
    """The key of a row."""
    return tuple(found[table.names.index(name)] for name in table.key.split(", "))


def _step(table: Table) -> int:
    return table.names.index("step")


def salvaged(path: Path) -> Salvaged:
    """All that is intact in the ledger at `path` and in its write-ahead log. Reads the log, too; writes nothing."""
    found = _Found()
    righted: list[str] = []
    bad: dict[tuple[str, Row], Row] = {}
    with pages_of(path) as moments:
        for pages in moments:
            for page, at in _doubtful(pages, found, bad)[:MOST_TRIED]:
                for table, values in _put_back(pages, page, at):
                    if found.add(table, values):
                        righted.append(f"row of {table.name} with {named_key(table, values)}")
    version, unread = _by_sqlite(path, found)
    damaged: dict[str, list[Row]] = {}
    for (name, key), values in bad.items():
        if key not in found.good[name]:
            damaged.setdefault(name, []).append(values[:-1])
    rows = {name: [known[key] for key in sorted(known)] for name, known in found.good.items()}
    return Salvaged(rows, version, righted, damaged, unread)


def _doubtful(pages: Pages, found: _Found, bad: dict[tuple[str, Row], Row]) -> list[tuple[bytes, int]]:
    """Add all sound rows to `found`, and what may be damaged ones to `bad`; returns where damaged ones lie."""
    doubtful = []
    for page, cells in pages.leaves():
        for n, at in enumerate(cells):
            fits = fitting(pages, page, at)
            sound = [found_as for found_as in fits if _is_sound(found_as[1])]
            for table, values in sound:
                found.add(table, values)
            if at in cells[:n]:  # another's pointer that was damaged
                doubtful.append((page, at))
            elif not sound and page[0] == LEAF and not _of_schema(pages, page, at):
                doubtful.append((page, at))
                bad |= {(table.name, key_of(table, values)): values for table, values in fits}
    return doubtful


def _is_sound(found: Row) -> bool:
    return bool(checksum(found[:-1]) == found[-1])


def _of_schema(pages: Pages, page: bytes, at: int) -> bool:
    """Whether the cell is a row of SQLite's own table of tables."""
    try:
        return pages.cell(page, at).values[:1] in (("table",), ("index",), ("trigger",))
    except (NoCell, IndexError, struct.error):
        return False


def _put_back(pages: Pages, page: bytes, at: int) -> Iterator[tuple[Table, Row]]:
    """Rows that a damaged cell is with one bit of it put back, or of the pointer to it."""
    for bit in range(16):
        yield from (fits for fits in fitting(pages, page, at ^ (1 << bit)) if _is_sound(fits[1]))
    fits = fitting(pages, page, at)
    for table, values in fits:
        if (righted := one_bit_off(values)) is not None:
            yield table, righted
            return
    try:
        cell = pages.cell(page, at)
        local = cell.local_bytes
        zones = range(at, at + (local if local <= SMALL_BYTES else max(HEAD_BYTES, cell.head_bytes)))
    except (NoCell, IndexError, struct.error):
        zones = range(min(at, len(page)), min(at + HEAD_BYTES, len(page)))
    tried = bytearray(page)
    for byte in zones:
        for bit in range(8):
            tried[byte] ^= 1 << bit
            sound = [fits for fits in fitting(pages, bytes(tried), at) if _is_sound(fits[1])]
            if sound:
                yield from sound
                return
            tried[byte] ^= 1 << bit


def one_bit_off(found: Row) -> Row | None:
    """The row of which `found` differs by one bit of its text, bytes, fractions or checksum; None where there is none.

    CRC-32 is linear: what one flipped bit does to it depends on its distance from the end alone.
    """
    *values, crc = found
    data = packed(values)
    wrong = zlib.crc32(data) ^ crc
    if wrong.bit_count() == 1:
        return (*values, crc ^ wrong)
    place = _place_of(wrong, len(data))
    if place is None:
        return None
    at, bit = place
    righted = bytearray(data)
    righted[at] ^= 1 << bit
    try:
        back = msgpack.unpackb(bytes(righted))
    except (ValueError, msgpack.UnpackException):
        return None
    kept = len(values) - len(back) if isinstance(back, list) else -1
    if kept < 0 or any(type(was) is not type(now) for was, now in zip(values, back, strict=False)):
        return None
    now = (*back, *[None] * kept)
    return (*now, crc) if checksum(now) == crc else None


def _place_of(wrong: int, size: int) -> tuple[int, int] | None:
    """(byte, bit) whose flip changes the CRC-32 of `size` bytes by `wrong`."""
    change = 1  # what the last byte's highest bit is when it leaves the register; every bit before it a step later
    for back in range(size):
        for bit in range(7, -1, -1):
            change = (change >> 1) ^ (_POLYNOMIAL if change & 1 else 0)
            if change == wrong:
                return size - 1 - back, bit
    return None


def _by_sqlite(path: Path, found: _Found) -> tuple[int, list[str]]:
    """Add what SQLite itself can read; returns the version of the schema, and where it stopped, in words."""
    version, stopped = SCHEMA_VERSION, []
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, isolation_level=None)) as db:
        db.text_factory = lambda raw: raw.decode("utf-8", "surrogateescape")
        db.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MOST_BYTES)
        try:
            (said,) = db.execute("PRAGMA user_version").fetchone()
        except DAMAGE as error:
            return version, [f"SQLite cannot read it: {error}"]
        version = said if OLDEST_VERSION <= said <= SCHEMA_VERSION else SCHEMA_VERSION
        for table in (table for table in TABLES if table.since <= version):
            try:
                for values in db.execute(table.select(version)):
                    if _is_sound(values):
                        found.add(table, values)
            except DAMAGE as error:
                stopped.append(f"{table.name}: SQLite stopped at damage: {error}")
    return version, stopped
