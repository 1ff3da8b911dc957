"""The camera's log on disk: one SQLite file, one transaction per batch, durable before an entry is sent.

WAL with synchronous=FULL: a batch is on the disk when `append` returns. What the aggregator committed is written
without waiting for the disk: it is only a hint which entries need not be sent again. SQLite notices damaged pages but
not damaged values, so every row carries a checksum, and the numbers must be complete.
"""

from __future__ import annotations

import sqlite3
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from conveyor.errors import LedgerError, MessageError, StorageError
from conveyor.files import unwritable
from conveyor.messages import TrackEntry
from segmenter.old_log import read_old_log

APPLICATION_ID = 0x54424C4C  # 'TBLL'
VERSION = 2
"""Version 1 was an append-only file of our own, see `old_log`."""
OLD_SUFFIX = ".log"
BUSY_TIMEOUT_S = 5.0
_SCHEMA = f"""
CREATE TABLE entry (n INTEGER PRIMARY KEY, crc INTEGER NOT NULL, payload BLOB NOT NULL) STRICT;
CREATE TABLE state (id INTEGER PRIMARY KEY CHECK (id = 1), camera TEXT NOT NULL, run TEXT NOT NULL,
    newest INTEGER NOT NULL, committed INTEGER NOT NULL, crc INTEGER NOT NULL) STRICT;
PRAGMA application_id = {APPLICATION_ID};
PRAGMA user_version = {VERSION};
"""
_FIXES = (
    ("disk is full", "free some space and start again; nothing that was sent is lost"),
    ("readonly", "give the user write access to the file and to its folder"),
    ("unable to open", "see that the folder exists and that this user may read and write there"),
    ("locked", "another process uses it; stop that one first"),
    ("I/O error", "the disk reports errors; check it, or name another folder in segmenter.state_dir"),
)
DAMAGED = "Move the file away to go on without the entries that were not committed"


@dataclass(frozen=True, slots=True)
class StoredLog:
    """What a file holds: entries in order, the newest number, and up to which one the aggregator has committed."""

    entries: tuple[TrackEntry, ...] = ()
    newest: int = 0
    committed: int = 0


class LogStore:
    """The open file at `path` of one camera in one run.

    `step` is called with a name before and after each write; lets a test kill the process at any of them.

    Raises (on entering):
        LedgerError: not a log, of another camera or run, or damaged. StorageError: in use, or unwritable.
    """

    def __init__(self, path: Path, *, camera: str, run: str) -> None:
        self.path = path
        self.camera = camera
        self.run = run
        self.step: Callable[[str], None] = lambda name: None

    def __enter__(self) -> Self:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self._explained("open"):
            # One thread at a time, not always the same one: see `log_writer`.
            self._db = sqlite3.connect(self.path, isolation_level=None, timeout=BUSY_TIMEOUT_S, check_same_thread=False)
            try:
                self._prepare()
            except BaseException:
                self._db.close()
                raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._db.close()

    def load(self) -> StoredLog:
        """Everything the file holds."""
        with self._explained("read"):
            state = self._state()
            rows = self._db.execute("SELECT n, crc, payload FROM entry ORDER BY n").fetchall()
        if state is None:
            if rows:
                raise self._damaged("its state is missing")
            return StoredLog()
        newest, committed = state
        entries = tuple(self._entry(*row) for row in rows)
        waiting = [entry.n for entry in entries if entry.n > committed]
        if waiting != list(range(committed + 1, newest + 1)):
            raise self._damaged(f"of the entries {committed + 1} to {newest} it holds {len(waiting)}")
        return StoredLog(entries, newest, committed)

    def append(self, entries: Iterable[TrackEntry], *, newest: int, committed: int) -> None:
        """Store entries; they are on the disk when this returns."""
        with self._transaction("append"):
            self._insert(entries)
            self._set_state(newest, committed)

    def commit(self, *, newest: int, committed: int, keep: Iterable[int], moved: Iterable[TrackEntry] = ()) -> None:
        """The aggregator has made entries up to `committed` durable: forget them, but for those to `keep`.

        Entries that wait and were `moved` to numbers behind `committed` take their places in the same transaction, and
        are on the disk when this returns.
        """
        kept, moved = sorted(set(keep)), tuple(moved)
        with self._explained("write"):
            if not moved:
                self._db.execute("PRAGMA synchronous = NORMAL")
            try:
                with self._transaction("commit"):
                    marks = ", ".join("?" * len(kept))
                    self._db.execute(f"DELETE FROM entry WHERE n <= ? AND n NOT IN ({marks})", (committed, *kept))
                    self._insert(moved)
                    self._set_state(newest, committed)
            finally:
                self._db.execute("PRAGMA synchronous = FULL")

    def _prepare(self) -> None:
        self._db.execute("PRAGMA journal_mode = WAL")
        self._db.execute("PRAGMA synchronous = FULL")
        if not self._db.execute("SELECT 1 FROM sqlite_master").fetchone():
            self._db.executescript(f"BEGIN IMMEDIATE; {_SCHEMA} COMMIT;")
        (application,) = self._db.execute("PRAGMA application_id").fetchone()
        (version,) = self._db.execute("PRAGMA user_version").fetchone()
        if (application, version) != (APPLICATION_ID, VERSION):
            raise LedgerError(
                f"{self.path} is no track log of version {VERSION} (application {application}, version {version}): "
                "move it away; its entries are not readable"
            )
        found = self._db.execute("PRAGMA quick_check").fetchone()[0]
        if found != "ok":
            raise self._damaged(str(found))
        self._take_over()

    def _take_over(self) -> None:
        """Entries of a log of version 1 beside this one are taken over; its file goes once they are on the disk."""
        old = self.path.with_suffix(OLD_SUFFIX)
        if old == self.path or not old.exists():
            return
        entries, newest, committed = read_old_log(old, camera=self.camera, run=self.run)
        had_newest, had_committed = self._state() or (0, 0)
        newest, committed = max(newest, had_newest), max(committed, had_committed)
        with self._transaction("take over"):
            self._insert(entry for entry in entries if entry.n > had_newest)
            self._set_state(newest, committed)
        old.unlink()

    def _insert(self, entries: Iterable[TrackEntry]) -> None:
        payloads = ((entry.n, entry.encode()) for entry in entries)
        rows = ((n, zlib.crc32(payload, n), payload) for n, payload in payloads)
        self._db.executemany("INSERT INTO entry (n, crc, payload) VALUES (?, ?, ?)", rows)

    def _set_state(self, newest: int, committed: int) -> None:
        row = (self.camera, self.run, newest, committed)
        self._db.execute("INSERT OR REPLACE INTO state VALUES (1, ?, ?, ?, ?, ?)", (*row, _crc(row)))

    def _state(self) -> tuple[int, int] | None:
        """(newest, committed); None in a file that is new."""
        row = self._db.execute("SELECT camera, run, newest, committed, crc FROM state").fetchone()
        if row is None:
            return None
        if _crc(row[:4]) != row[4]:
            raise self._damaged("its state fails its checksum")
        camera, run, newest, committed = row[:4]
        if (camera, run) != (self.camera, self.run):
            raise LedgerError(
                f"{self.path} is the log of camera '{camera}', run '{run}', not of camera '{self.camera}', "
                f"run '{self.run}'"
            )
        return newest, committed

    def _entry(self, n: int, crc: int, payload: bytes) -> TrackEntry:
        if zlib.crc32(payload, n) != crc:
            raise self._damaged(f"entry {n} fails its checksum")
        try:
            return TrackEntry.decode(payload)
        except MessageError as error:
            raise self._damaged(f"entry {n}: {error}") from error

    def _damaged(self, what: str) -> LedgerError:
        return LedgerError(f"{self.path} is damaged: {what}. {DAMAGED}")

    @contextmanager
    def _transaction(self, name: str) -> Iterator[None]:
        with self._explained("write"):
            self.step(f"{name}: begin")
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield
                self.step(f"{name}: commit")
                self._db.execute("COMMIT")
            except BaseException:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                raise
            self.step(f"{name}: done")

    @contextmanager
    def _explained(self, doing: str) -> Iterator[None]:
        try:
            yield
        except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
            fix = next((text for sign, text in _FIXES if sign in str(error)), None)
            if fix is not None and "locked" not in str(error):
                fix = unwritable(self.path.parent) or fix
            kind = LedgerError if fix is None else StorageError
            raise kind(f"cannot {doing} the track log {self.path}: {error}: {fix or DAMAGED}") from error


def _crc(row: tuple[object, ...]) -> int:
    return zlib.crc32(repr(row).encode())
