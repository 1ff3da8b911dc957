"""Reads the camera's log of version 0.1, an append-only file of our own; nothing writes it any more.

After the magic come records of length, CRC-32 and payload, each a `TrackEntry` or a `Committed`. A torn last record,
which a crash may leave, is cut off; damage anywhere else is an error.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

from conveyor.errors import LedgerError, MessageError
from conveyor.messages import Committed, TrackEntry

MAGIC = b"TBLLOG1\n"
MAX_RECORD_BYTES = 1 << 20
_PREFIX = struct.Struct("<II")


def read_old_log(path: Path, *, camera: str, run: str) -> tuple[list[TrackEntry], int, int]:
    """(entries in order, number of the newest, up to which one the aggregator has committed).

    Raises:
        LedgerError: the file is no such log, is damaged, or belongs to another camera or run.
    """
    data = path.read_bytes()
    if data and not data.startswith(MAGIC):
        raise LedgerError(f"{path} is not a track log of version 0.1: move it away; its entries are not readable")
    entries: dict[int, TrackEntry] = {}
    newest = committed = 0
    for record in _records(data, path):
        item = _decoded(record)
        if (item.camera, item.run) != (camera, run):
            raise LedgerError(
                f"{path} is the log of camera '{item.camera}', run '{item.run}', not of camera '{camera}', run '{run}'"
            )
        newest = max(newest, item.n)
        if isinstance(item, Committed):
            committed = max(committed, item.n)
        else:
            entries[item.n] = item
    return [entries[n] for n in sorted(entries)], newest, committed


def _decoded(record: bytes) -> TrackEntry | Committed:
    try:
        return TrackEntry.decode(record)
    except MessageError:
        return Committed.decode(record)


def _records(data: bytes, path: Path) -> list[bytes]:
    """The records. Damage that more than a torn last write can explain is an error."""
    at, records = len(MAGIC), []
    while at + _PREFIX.size <= len(data):
        size, checksum = _PREFIX.unpack_from(data, at)
        if size == 0 and not any(data[at:]):
            break
        end = at + _PREFIX.size + size
        payload = data[at + _PREFIX.size : end]
        if size > MAX_RECORD_BYTES or end > len(data) or zlib.crc32(payload) != checksum:
            if size <= MAX_RECORD_BYTES and end < len(data):
                raise LedgerError(
                    f"{path} is damaged at byte {at}: a record of {size} bytes fails its checksum, and more follows. "
                    "Move the file away to go on without the entries that were not committed"
                )
            break
        records.append(payload)
        at = end
    return records
