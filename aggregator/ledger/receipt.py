"""The receipt beside the ledger: the number of the last batch that was acknowledged.

SQLite drops a damaged tail of its write-ahead log without a word, and with it commits that were acknowledged. The
receipt is written after each commit and before the acknowledgement, so a ledger that holds fewer batches than its
receipt says has lost some, and is refused. Two slots are written in turn: a torn write leaves the other one.
"""

from __future__ import annotations

import fcntl
import os
import struct
import time
import zlib
from pathlib import Path
from types import TracebackType
from typing import Self

from conveyor.errors import LedgerError, StorageError

_SLOT = struct.Struct("<8sQI")
_MAGIC = b"TUBRACK1"
_STRIDE = 4096
ASKED_MOST, ASKED_AGAIN_S = 10, 0.01
"""So often, and so far apart, the lock is asked for: readers hold it for a moment (`is_being_written`)."""


def receipt_path(ledger: Path) -> Path:
    """Where the receipt of `ledger` lies."""
    return ledger.with_suffix(".ack")


class Receipt:
    """The open receipt of a ledger that is being written, locked: one writer at a time. Use as a context manager."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._fd = -1

    def __enter__(self) -> Self:
        try:
            self._fd = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
            self._lock()
        except BlockingIOError as error:
            os.close(self._fd)
            raise StorageError(
                f"the ledger in {self._path.parent} is being written by another process; stop it, or use another folder"
            ) from error
        except OSError as error:
            raise StorageError(f"receipt {self._path} cannot be written: {error.strerror}") from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _lock(self) -> None:
        for left in reversed(range(ASKED_MOST)):  # who asks whether it is being written has it for a moment
            try:
                fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
            except BlockingIOError:
                if not left:
                    raise
                time.sleep(ASKED_AGAIN_S)

    def write(self, seq: int) -> None:
        """Make durable that batches 1..seq may be acknowledged."""
        body = _MAGIC + struct.pack("<Q", seq)
        try:
            os.pwrite(self._fd, body + struct.pack("<I", zlib.crc32(body)), _STRIDE * (seq % 2))
            os.fdatasync(self._fd)
        except OSError as error:
            raise StorageError(
                f"receipt {self._path} cannot be written: {error.strerror}; nothing is acknowledged"
            ) from error


def is_being_written(ledger: Path) -> bool:
    """Whether some process has `ledger` open for writing; False where that cannot be told."""
    try:
        fd = os.open(receipt_path(ledger), os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError as error:
        return isinstance(error, BlockingIOError)
    finally:
        os.close(fd)
    return False


def read_receipt(path: Path) -> int | None:
    """The last acknowledged batch; None where there is no receipt, or nothing was ever written to it.

    Raises:
        LedgerError: the file is there, but neither slot can be trusted.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise LedgerError(f"receipt {path} cannot be read: {error.strerror}") from error
    if not data:
        return None
    slots = [_slot(data[at : at + _SLOT.size]) for at in (0, _STRIDE)]
    if all(seq is None for seq in slots):
        raise LedgerError(
            f"receipt {path} is damaged, so it is unknown how much of the ledger was acknowledged; "
            "`tuberline ledger repair` keeps what the ledger holds and writes a new receipt"
        )
    return max(seq for seq in slots if seq is not None)


def _slot(data: bytes) -> int | None:
    if len(data) < _SLOT.size:
        return None
    magic, seq, crc = _SLOT.unpack(data)
    return int(seq) if magic == _MAGIC and crc == zlib.crc32(data[:16]) else None
