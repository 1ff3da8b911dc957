"""The camera's log: numbered entries, kept on disk until the aggregator says that they are durable in the ledger.

The file is append-only: records of length, CRC-32 and payload, fsynced before an entry is sent. A torn last record,
which a crash may leave, is cut off; damage anywhere else is an error. The file is rewritten when it has grown and
little of it is still needed.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections import deque
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

from conveyor.errors import LedgerError, MessageError, StorageError
from conveyor.messages import Committed, Mark, Track, TrackEntry

MAGIC = b"TBLLOG1\n"
MAX_RECORD_BYTES = 1 << 20
MAX_UNCOMMITTED = 100_000
REWRITE_BYTES = 4 << 20
RESEND_AFTER_S = 1.0
RESEND_AT_MOST = 512
_PREFIX = struct.Struct("<II")


class TrackLog:
    """Entries 1, 2, 3, ... of one camera in one run. Without a path it lives in memory and dies with the process."""

    def __init__(self, path: Path | None, *, camera: str, run: str) -> None:
        self.camera = camera
        self.run = run
        self.committed = 0
        self.last_mark: Mark | None = None
        self.cut_bytes = 0
        self._path = path
        self._file: BinaryIO | None = None
        self._entries: deque[TrackEntry] = deque()
        self._since_mark: list[TrackEntry] = []
        self._mark_before: TrackEntry | None = None
        self._next = 1
        self._unsent_from = 1
        self._progress_s: float | None = None
        self._patience_s = RESEND_AFTER_S

    def __enter__(self) -> Self:
        if self._path is not None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._restore(self._path)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None

    @property
    def newest(self) -> int:
        """Number of the newest entry."""
        return self._next - 1

    @property
    def since_mark(self) -> list[Track]:
        """Tracks logged after the last mark."""
        return [entry.track for entry in self._since_mark if entry.track is not None]

    @property
    def speed_mps(self) -> float:
        """The belt's speed between the last two marks, metres per second of the camera's clock; 0 if not known."""
        before, last = self._mark_before.mark if self._mark_before else None, self.last_mark
        if before is None or last is None or last.captured_ns <= before.captured_ns:
            return 0.0
        return max(0.0, (last.travel_m - before.travel_m) / (last.captured_ns - before.captured_ns) * 1e9)

    @property
    def uncommitted(self) -> int:
        """Entries the aggregator has not confirmed."""
        return len(self._entries)

    @property
    def finished(self) -> bool:
        """The final mark is written and everything is committed."""
        return self.last_mark is not None and self.last_mark.final and not self._entries

    def append(self, items: list[Track | Mark]) -> None:
        """Number and store tracks and marks, durably, all with one fsync.

        Raises:
            StorageError: too much waits for the aggregator, or the disk refuses.
        """
        if len(self._entries) + len(items) > MAX_UNCOMMITTED:
            raise StorageError(
                f"the log of camera '{self.camera}' holds {len(self._entries)} entries that the aggregator has not "
                f"committed (limit {MAX_UNCOMMITTED}): is it running, and can it write its ledger?"
            )
        for item in items:
            entry = TrackEntry(
                camera=self.camera,
                run=self.run,
                n=self._next,
                track=item if isinstance(item, Track) else None,
                mark=None if isinstance(item, Track) else item,
            )
            self._write(entry.encode())
            self._entries.append(entry)
            self._next += 1
            self._note(entry)
        self._sync()

    def commit(self, n: int) -> None:
        """The aggregator has made entries 1..n durable."""
        if n <= self.committed:
            return
        self.committed = n
        self._patience_s = RESEND_AFTER_S
        self._progress_s = None
        while self._entries and self._entries[0].n <= n:
            self._entries.popleft()
        self._unsent_from = max(self._unsent_from, n + 1)
        self._next = max(self._next, n + 1)
        self._write(Committed(camera=self.camera, run=self.run, n=n).encode())
        if self._file is not None and self._file.tell() > REWRITE_BYTES and len(self._entries) < 1000:
            self._rewrite()

    def due(self, now_s: float) -> list[TrackEntry]:
        """Entries to send now: the new ones; all uncommitted ones when nothing was confirmed for a while."""
        if self._progress_s is None:
            self._progress_s = now_s
        if self._entries and now_s - self._progress_s >= self._patience_s:
            self._progress_s = now_s
            self._patience_s = min(2 * self._patience_s, 8.0)
            self._unsent_from = self._entries[0].n
        sending = [entry for entry in self._entries if entry.n >= self._unsent_from][:RESEND_AT_MOST]
        if sending:
            self._unsent_from = sending[-1].n + 1
        return sending

    def resend(self) -> None:
        """Send everything uncommitted again at the next `due`: the aggregator came back."""
        if self._entries:
            self._unsent_from = self._entries[0].n

    def _restore(self, path: Path) -> None:
        data = path.read_bytes() if path.exists() else b""
        if data and not data.startswith(MAGIC):
            raise LedgerError(f"{path} is not a track log of this version: move it away; its entries are not readable")
        good, records = _records(data, path)
        self.cut_bytes = len(data) - good if data else 0
        for record in records:
            self._replay(record, path)
        while self._entries and self._entries[0].n <= self.committed:
            self._entries.popleft()
        self._unsent_from = self.committed + 1
        self._file = path.open("r+b" if data else "w+b")
        if data:
            self._file.truncate(good)
            self._file.seek(good)
        else:
            self._file.write(MAGIC)
        self._sync()

    def _replay(self, record: bytes, path: Path) -> None:
        try:
            entry = TrackEntry.decode(record)
        except MessageError:
            committed = Committed.decode(record)
            self._own(committed.camera, committed.run, path)
            self.committed = max(self.committed, committed.n)
            self._next = max(self._next, committed.n + 1)
            return
        self._own(entry.camera, entry.run, path)
        self._entries.append(entry)
        self._next = max(self._next, entry.n + 1)
        self._note(entry)

    def _note(self, entry: TrackEntry) -> None:
        """A process that starts again needs the last two marks and what came after them, committed or not."""
        if entry.mark is not None:
            if self._since_mark and self._since_mark[0].mark is not None:
                self._mark_before = self._since_mark[0]
            self.last_mark = entry.mark
            self._since_mark = []
        self._since_mark.append(entry)

    def _own(self, camera: str, run: str, path: Path) -> None:
        if (camera, run) != (self.camera, self.run):
            raise LedgerError(
                f"{path} is the log of camera '{camera}', run '{run}', not of camera '{self.camera}', run '{self.run}'"
            )

    def _write(self, payload: bytes) -> None:
        if self._file is not None:
            try:
                self._file.write(_PREFIX.pack(len(payload), zlib.crc32(payload)) + payload)
            except OSError as error:
                raise StorageError(f"cannot write the track log {self._path}: {error.strerror or error}") from error

    def _sync(self) -> None:
        if self._file is not None:
            try:
                self._file.flush()
                os.fsync(self._file.fileno())
            except OSError as error:
                raise StorageError(f"cannot write the track log {self._path}: {error.strerror or error}") from error

    def _rewrite(self) -> None:
        """A fresh file with what is still needed, put in place of the old one at once."""
        if self._path is None or self._file is None:
            return
        fresh = self._path.with_suffix(".new")
        try:
            self._file.close()
            with fresh.open("wb") as file:
                file.write(MAGIC)
                before = [self._mark_before] if self._mark_before else []
                needed = {entry.n: entry for entry in [*before, *self._since_mark, *self._entries]}
                committed = Committed(camera=self.camera, run=self.run, n=self.committed)
                for item in [committed, *(needed[n] for n in sorted(needed))]:
                    payload = item.encode()
                    file.write(_PREFIX.pack(len(payload), zlib.crc32(payload)) + payload)
                file.flush()
                os.fsync(file.fileno())
            fresh.replace(self._path)
            folder = os.open(self._path.parent, os.O_RDONLY)
            os.fsync(folder)
            os.close(folder)
            self._file = self._path.open("r+b")
            self._file.seek(0, os.SEEK_END)
        except OSError as error:
            raise StorageError(f"cannot write the track log {self._path}: {error.strerror or error}") from error


def _records(data: bytes, path: Path) -> tuple[int, list[bytes]]:
    """(length of the undamaged part, its records). Damage that more than a torn last write can explain is an error."""
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
    return at, records
