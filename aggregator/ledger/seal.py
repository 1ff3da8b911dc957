"""The seal of a ledger at rest: a digest of the whole file, in its receipt.

Row checksums find a flipped bit in any row. The seal also finds one where no row is: in a page's unused bytes, in the
schema's text, in SQLite's header. It is made when a writer closes the ledger and broken before the next one writes, so
a ledger whose writer was killed has none, and neither has one that is too large to be read within a stop.
"""

from __future__ import annotations

import hashlib
import os
import struct
import zlib
from pathlib import Path

from conveyor.errors import LedgerError

LARGEST_BYTES = 128 * 2**20
"""About 50,000 tubers; read and digested in 0.5 s on a busy machine, where a process has 2 s to stop."""

_AT = 8192
_SLOT = struct.Struct("<8sQ32sI")
_MAGIC = b"TUBRSEAL"


def set_seal(ledger: Path, receipt: Path) -> None:
    """Digest the file at rest into its receipt; a write-ahead log beside it, or a large file, leaves it unsealed."""
    if ledger.with_name(ledger.name + "-wal").exists() or ledger.stat().st_size > LARGEST_BYTES:
        return
    body = struct.pack("<8sQ32s", _MAGIC, ledger.stat().st_size, _digest(ledger))
    _write(receipt, body + struct.pack("<I", zlib.crc32(body)))


def break_seal(receipt: Path) -> None:
    """The file is about to change."""
    if receipt.exists() and receipt.stat().st_size > _AT:
        _write(receipt, bytes(_SLOT.size))


def seal_faults(ledger: Path, receipt: Path) -> list[str]:
    """What is wrong between the seal and the file, in words; empty where all is well, or where there is no seal."""
    try:
        data = receipt.read_bytes()[_AT : _AT + _SLOT.size]
        if len(data) < _SLOT.size or not any(data):
            return []
        magic, size, digest, crc = _SLOT.unpack(data)
        if magic != _MAGIC or crc != zlib.crc32(data[:-4]):
            return [f"the seal in receipt {receipt} is damaged"]
        if ledger.stat().st_size != size or _digest(ledger) != digest:
            return ["the file is not as its last writer left it (its seal is broken)"]
    except FileNotFoundError:
        return []
    except OSError as error:
        return [f"the seal cannot be checked: {error.strerror}"]
    return []


def _digest(path: Path) -> bytes:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").digest()


def _write(receipt: Path, data: bytes) -> None:
    try:
        fd = os.open(receipt, os.O_WRONLY | os.O_CLOEXEC)
        try:
            os.pwrite(fd, data, _AT)
            os.fdatasync(fd)
        finally:
            os.close(fd)
    except OSError as error:
        raise LedgerError(f"receipt {receipt} cannot be written: {error.strerror}") from error
