"""Rows in the pages of an SQLite file, each page read by itself: for what SQLite itself no longer finds its way to.

The leaves of SQLite's trees hold whole rows, so damage elsewhere (a branch, a page's count, the schema, a frame of the
write-ahead log) hides rows that are intact. Layout: "Database File Format" (sqlite.org/fileformat2.html), sections 1.6,
2.1 and 4.1. Whether what is read here is a row, and as it was written, only its checksum can say.
"""

from __future__ import annotations

import mmap
import os
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from itertools import chain, pairwise
from pathlib import Path

LEAF, BRANCHES_AND_INDEXES = 0x0D, (0x02, 0x05, 0x0A)
"""The first byte of a page of a tree."""
HEADER_BYTES = 100
"""Of the file, on its first page."""
PAGE_BYTES = 4096
"""Of a ledger, where the header does not say."""
MOST_BYTES = 2**26
"""No row of a ledger is larger."""
LOG_HEADER_BYTES, FRAME_HEADER_BYTES = 32, 24
"""Of a write-ahead log, and of each page in it."""
_INT_BYTES = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8}

Value = int | float | str | bytes | None


class NoCell(Exception):
    """These bytes are no row."""


@dataclass(frozen=True, slots=True)
class Cell:
    """A row as it lies in a page.

    Attributes:
        head_bytes: its length, its number and the types of its columns.
        local_bytes: all of it that lies in this page.
        rowid: SQLite's number of the row. values: its columns; text that is not UTF-8 with its bytes escaped.
    """

    head_bytes: int
    local_bytes: int
    rowid: int
    values: tuple[Value, ...]


@dataclass(frozen=True, slots=True)
class Pages:
    """Pages of one moment: those in `log`, by number from 1 on, before those of the file; all of `size` bytes."""

    file: bytes | mmap.mmap
    size: int
    log: Mapping[int, bytes]

    def page(self, number: int) -> bytes | None:
        """The page of that number; None where there is none."""
        if number in self.log:
            return self.log[number]
        at = (number - 1) * self.size
        return self.file[at : at + self.size] if 0 <= at <= len(self.file) - self.size else None

    def leaves(self) -> Iterator[tuple[bytes, list[int]]]:
        """(page, where its cells begin) of all that may be a leaf of a table."""
        last = len(self.file) // self.size
        for number in chain(range(1, last + 1), sorted(number for number in self.log if number > last)):
            page = self.page(number)
            begin = HEADER_BYTES if number == 1 else 0
            if page is not None and page[begin] not in BRANCHES_AND_INDEXES:
                yield page, self._cells(page, begin)

    def _cells(self, page: bytes, begin: int) -> list[int]:
        """By the page's count and, for that may be damaged, on until there is no pointer any more."""
        (count,) = struct.unpack_from(">H", page, begin + 3)
        found: list[int] = []
        at = begin + 8
        while at + 2 <= self.size:
            (pointer,) = struct.unpack_from(">H", page, at)
            if not at < pointer < self.size and len(found) >= count:
                break
            found.append(pointer)
            at += 2
        return found

    def cell(self, page: bytes, at: int) -> Cell:
        """The row that begins there.

        Raises:
            NoCell: none does.
        """
        size, after = _varint(page, at)  # past the page's end where a pointer is damaged
        rowid, after = _varint(page, after)
        if not 1 < size <= MOST_BYTES:
            raise NoCell
        payload, local_end = self._payload(page, after, size)
        values, types_end = _record(payload)
        return Cell(after - at + types_end, local_end - at, rowid - 2**64 if rowid >= 2**63 else rowid, values)

    def _payload(self, page: bytes, begin: int, size: int) -> tuple[bytes, int]:
        """A row's bytes, from this page and those it runs over to; and where they end in this one."""
        usable = self.size  # nothing is reserved at the end of a ledger's pages
        most = usable - 35
        if size <= most:
            return _taken(page, begin, size), begin + size
        least = (usable - 12) * 32 // 255 - 23
        local = least + (size - least) % (usable - 4)
        local = local if local <= most else least
        parts = [_taken(page, begin, local)]
        (following,) = struct.unpack(">I", _taken(page, begin + local, 4))
        missing, seen = size - local, set()
        while missing > 0:
            over = self.page(following)
            if over is None or following in seen:
                raise NoCell
            seen.add(following)
            parts.append(over[4 : min(usable, 4 + missing)])
            missing -= len(parts[-1])
            (following,) = struct.unpack_from(">I", over)
        return b"".join(parts), begin + local + 4


@contextmanager
def pages_of(path: Path) -> Iterator[list[Pages]]:
    """The pages of a file, and of its write-ahead log where it has one: as they are with all that was committed, and
    as they are in the file, for a page of the log may be the damaged one.

    A log is taken up to its last commit, whatever its checksums say: SQLite drops all that follows a damaged frame.
    """
    with path.open("rb") as opened:
        empty = os.fstat(opened.fileno()).st_size == 0
        with nullcontext(b"") if empty else mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ) as file:
            size = _page_size(file)
            log = _logged(path.with_name(path.name + "-wal"), size)
            yield [Pages(file, size, log), *([Pages(file, size, {})] if log else [])]


def _page_size(file: bytes | mmap.mmap) -> int:
    """Bytes of a page; those of a ledger where the header is damaged."""
    size = int.from_bytes(file[16:18], "big")
    size = 65536 if size == 1 else size
    sound = size >= 512 and size & (size - 1) == 0 and len(file) % size == 0
    return size if sound else PAGE_BYTES


def _logged(log: Path, size: int) -> dict[int, bytes]:
    """The newest pages of a write-ahead log that belong to a commit."""
    try:
        data = log.read_bytes()
    except FileNotFoundError:
        return {}
    frames = range(LOG_HEADER_BYTES, len(data) - FRAME_HEADER_BYTES - size + 1, FRAME_HEADER_BYTES + size)
    salts = _round(data, frames)
    committed: dict[int, bytes] = {}
    waiting: dict[int, bytes] = {}
    for at in frames:
        if data[at + 8 : at + 16] != salts:
            continue  # of an earlier round of the log, or damaged
        number, commits = struct.unpack_from(">II", data, at)
        begin = at + FRAME_HEADER_BYTES
        waiting[number] = data[begin : begin + size]
        if commits:
            committed |= waiting
            waiting = {}
    return committed


def _round(data: bytes, frames: range) -> bytes:
    """What marks the frames of the log's newest round: as its header says, else as its first two alike do."""
    marks = [data[at + 8 : at + 16] for at in frames]
    if any(data[16:24]) and data[16:24] in marks:
        return data[16:24]
    return next((one for one, other in pairwise(marks) if one == other and any(one)), b"")


def _taken(data: bytes, at: int, count: int) -> bytes:
    if at + count > len(data):
        raise NoCell
    return data[at : at + count]


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for n in range(9):
        if at + n >= len(data):
            raise NoCell
        byte = data[at + n]
        if n == 8:
            return value << 8 | byte, at + 9
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value, at + n + 1
    raise NoCell


def _record(payload: bytes) -> tuple[tuple[Value, ...], int]:
    """(columns, where they begin) of a record."""
    types_end, at = _varint(payload, 0)
    if not 1 < types_end <= len(payload):
        raise NoCell
    types: list[int] = []
    while at < types_end:
        kind, at = _varint(payload, at)
        types.append(kind)
    values, at = _columns(payload, at, types)
    if at != len(payload):
        raise NoCell
    return values, types_end


def _columns(payload: bytes, at: int, types: Sequence[int]) -> tuple[tuple[Value, ...], int]:
    values: list[Value] = []
    for kind in types:
        if kind == 0:
            values.append(None)
        elif kind in _INT_BYTES:
            raw = _taken(payload, at, _INT_BYTES[kind])
            values.append(int.from_bytes(raw, "big", signed=True))
            at += len(raw)
        elif kind == 7:
            values.append(struct.unpack(">d", _taken(payload, at, 8))[0])
            at += 8
        elif kind in (8, 9):
            values.append(kind - 8)
        elif kind >= 12:
            raw = _taken(payload, at, (kind - 12) // 2)
            values.append(raw.decode("utf-8", "surrogateescape") if kind % 2 else raw)
            at += len(raw)
        else:
            raise NoCell
    return tuple(values), at
