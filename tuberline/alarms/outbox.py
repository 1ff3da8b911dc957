"""What is still to be sent, per channel and in order, and which alarms were begun: bounded, and kept across restarts.

Memory holds it, a small SQLite file holds the same. Where the disk takes nothing (it may be full, or read-only: that is
an alarm) messages leave all the same, and the file is written again as soon as it can be.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import sqlite3
import threading
import time
import uuid
from collections import deque
from collections.abc import Iterable, Sequence
from pathlib import Path

from conveyor.config import LineConfig
from conveyor.errors import StorageError, TakenError, TuberlineError
from tuberline.alarms.machine import Active, AlarmMachine, Timing
from tuberline.alarms.message import AlarmMessage

log = logging.getLogger("alarms")

FOLDER, FILE = "alarms", "alarms.db"
"""Where messages wait, in the aggregator's folder unless the config names another."""
TABLES = {
    "facts": "name TEXT PRIMARY KEY, value TEXT NOT NULL",
    "active": "key TEXT PRIMARY KEY, begun TEXT NOT NULL, begun_unix_s REAL NOT NULL",
    "waiting": "channel TEXT NOT NULL, n INTEGER NOT NULL, message TEXT NOT NULL, PRIMARY KEY (channel, n)",
}
Change = tuple[str, tuple[object, ...]]


class Outbox:
    """The messages of one line for its channels. Use as a context manager; every method may be called from any thread.

    Args:
        folder: where the file is; made if it is not there.
        channels: their ids; messages for others are removed.
        keep: messages per channel; of more the oldest are given up, counted, and the next one says how many.

    Raises:
        TakenError: another process has it.
        StorageError: the folder cannot be written, though its disk can.
    """

    def __init__(self, folder: Path, *, channels: Sequence[str], keep: int) -> None:
        self._folder = folder
        self._keep = keep
        self._changed = threading.Condition()
        self._queues: dict[str, deque[tuple[int, AlarmMessage]]] = {channel: deque() for channel in channels}
        self._lost = dict.fromkeys(channels, 0)
        self._active: dict[str, tuple[AlarmMessage, float]] = {}
        self._recent: dict[str, float] = {}
        self._number, self._n = 0, 0
        self._prefix = uuid.uuid4().hex[:12]
        self._whole = True
        self._read_only = _on_read_only_disk(folder)
        self._db: sqlite3.Connection

    def __enter__(self) -> Outbox:
        if self._read_only:
            log.error("alarms cannot be kept in %s: its disk is read-only; they are sent all the same", self._folder)
        self._db = _read_only(self._folder / FILE) if self._read_only else _opened(self._folder)
        try:
            self._read()
        except (ValueError, TypeError, KeyError) as error:
            if not self._read_only:
                self._db.close()
                _set_aside(self._folder / FILE, error)
                self._db = _opened(self._folder)
            self._forget()
        with contextlib.suppress(sqlite3.Error):  # no room: it is tried again with the first message
            self._whole = False
            self._write_anew()
        return self

    def __exit__(self, *_: object) -> None:
        with self._changed:
            self._save(())
            self._db.close()

    def machine(self, line: str, *, timing: Timing, now_s: float, unix_s: float) -> AlarmMachine:
        """The machine that goes on where the last one ended."""
        active = {}
        for key, (begun, begun_unix_s) in self._active.items():
            begun_s = now_s - max(0.0, unix_s - begun_unix_s)
            active[key] = Active(begun, begun_s, now_s, unix_s)
        recent = {key: now_s - max(0.0, unix_s - begun_unix_s) for key, begun_unix_s in self._recent.items()}
        return AlarmMachine(line, timing, self._prefix, self._number, active, recent)

    def put(self, messages: Iterable[AlarmMessage], machine: AlarmMachine, *, now_s: float, unix_s: float) -> None:
        """Keep `messages` for every channel, and that their alarms have begun or ended: both or neither."""
        changes: list[Change] = []
        with self._changed:
            for message in messages:
                self._note(message, unix_s, changes)
                for channel in self._queues:
                    self._queue(channel, message, changes)
            self._number = machine.number
            self._recent = {key: unix_s - (now_s - begun_s) for key, begun_s in machine.recent_s.items()}
            changes += [_fact("number", self._number), _fact("recent", self._recent)]
            self._save(changes)
            self._changed.notify_all()

    def head(self, channel: str) -> tuple[int, AlarmMessage, int] | None:
        """(its number here, the oldest message for `channel`, how many were given up before it), or None."""
        with self._changed:
            queue = self._queues[channel]
            return (*queue[0], self._lost[channel]) if queue else None

    def done(self, channel: str, n: int, *, lost: int = 0) -> None:
        """Message `n` was taken, with the word that `lost` before it were given up. It may be gone already."""
        with self._changed:
            changes: list[Change] = []
            if self._queues[channel] and self._queues[channel][0][0] == n:
                self._queues[channel].popleft()
                changes.append(("DELETE FROM waiting WHERE channel = ? AND n = ?", (channel, n)))
            if lost:
                self._lost[channel] -= lost
                changes.append(_fact(f"lost {channel}", self._lost[channel]))
            self._save(changes)

    def waiting(self, channel: str) -> int:
        """Messages that `channel` has not taken."""
        with self._changed:
            return len(self._queues[channel])

    def wait(self, timeout_s: float) -> None:
        """Until something was put, or `timeout_s` is over."""
        with self._changed:
            self._changed.wait(timeout_s)

    def _note(self, message: AlarmMessage, begun_unix_s: float, changes: list[Change]) -> None:
        if message.event == "begin":
            self._active[message.key] = (message, begun_unix_s)
            row = (message.key, message.encode(), begun_unix_s)
            changes.append(("INSERT OR REPLACE INTO active VALUES (?, ?, ?)", row))
        else:
            self._active.pop(message.key, None)
            changes.append(("DELETE FROM active WHERE key = ?", (message.key,)))

    def _queue(self, channel: str, message: AlarmMessage, changes: list[Change]) -> None:
        queue = self._queues[channel]
        queue.append((self._n, message))
        changes.append(("INSERT INTO waiting VALUES (?, ?, ?)", (channel, self._n, message.encode())))
        self._n += 1
        while len(queue) > self._keep:
            n, _ = queue.popleft()
            self._lost[channel] += 1
            changes.append(("DELETE FROM waiting WHERE channel = ? AND n = ?", (channel, n)))
            changes.append(_fact(f"lost {channel}", self._lost[channel]))

    def _save(self, changes: Sequence[Change]) -> None:
        """Write `changes`, or everything where the last write failed."""
        try:
            if self._read_only and not _on_read_only_disk(self._folder):
                self._db, self._read_only = _opened(self._folder), False
            if not self._whole:
                self._write_anew()
                return
            with self._db:
                for statement, values in changes:
                    self._db.execute(statement, values)
        except (sqlite3.Error, TuberlineError) as error:
            if self._whole:
                log.error("alarms cannot be kept in %s: %s; they are sent all the same", self._folder / FILE, error)
            self._whole = False

    def _write_anew(self) -> None:
        with self._db:
            for table, columns in TABLES.items():
                self._db.execute(f"CREATE TABLE IF NOT EXISTS {table} ({columns})")
                self._db.execute(f"DELETE FROM {table}")
            facts: dict[str, object] = {"prefix": self._prefix, "number": self._number, "recent": self._recent}
            facts |= {f"lost {channel}": lost for channel, lost in self._lost.items()}
            self._db.executemany("INSERT INTO facts VALUES (?, ?)", [(k, json.dumps(v)) for k, v in facts.items()])
            rows = [(key, begun.encode(), unix_s) for key, (begun, unix_s) in self._active.items()]
            self._db.executemany("INSERT INTO active VALUES (?, ?, ?)", rows)
            waiting = [(c, n, message.encode()) for c, queue in self._queues.items() for n, message in queue]
            self._db.executemany("INSERT INTO waiting VALUES (?, ?, ?)", waiting)
        self._whole = True

    def _forget(self) -> None:
        self._active.clear()
        self._recent = {}
        for queue in self._queues.values():
            queue.clear()

    def _read(self) -> None:
        if self._db.execute("SELECT count(*) FROM sqlite_master").fetchone() == (0,):
            return  # new, perhaps on a full disk
        facts = {name: json.loads(value) for name, value in self._db.execute("SELECT name, value FROM facts")}
        self._prefix = facts.get("prefix", self._prefix)
        self._number = facts.get("number", 0)
        self._recent = facts.get("recent", {})
        for key, begun, unix_s in self._db.execute("SELECT key, begun, begun_unix_s FROM active"):
            self._active[key] = (AlarmMessage.decode(begun), unix_s)
        for channel in self._queues:
            self._lost[channel] = facts.get(f"lost {channel}", 0)
        left = 0
        for channel, n, message in self._db.execute("SELECT channel, n, message FROM waiting ORDER BY n"):
            self._n = max(self._n, n + 1)
            if channel in self._queues:
                self._queues[channel].append((n, AlarmMessage.decode(message)))
            else:
                left += 1
        if left:
            log.warning("%d messages for channels that are no longer configured are not sent", left)


def alarms_folder(config: LineConfig) -> Path:
    """Where a line's messages wait."""
    stated = config.alarms.state_dir if config.alarms is not None else None
    return stated or config.aggregator.out / FOLDER


def is_in_use(folder: Path) -> bool | None:
    """Whether a process holds the messages in `folder`, so that alarms are sent; None where that cannot be told."""
    path = folder / FILE
    try:
        if not path.is_file():
            return False
        if _on_read_only_disk(folder):  # no process can lock it
            return None
        with contextlib.closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=0.2)) as db:
            db.execute("SELECT count(*) FROM facts").fetchone()
    except sqlite3.OperationalError as error:
        return True if "locked" in str(error) else None
    except (OSError, sqlite3.Error):
        return None
    return False


def _fact(name: str, value: object) -> Change:
    return "INSERT OR REPLACE INTO facts VALUES (?, ?)", (name, json.dumps(value))


def _opened(folder: Path) -> sqlite3.Connection:
    """The file, locked for this process; a damaged one is set aside."""
    path = folder / FILE
    try:
        folder.mkdir(parents=True, exist_ok=True)
        try:
            return _connected(path)
        except sqlite3.OperationalError:
            raise
        except sqlite3.DatabaseError as error:
            _set_aside(path, error)
            return _connected(path)
    except sqlite3.OperationalError as error:
        if "locked" in str(error):
            raise TakenError(
                f"{path} is in use: another `tuberline alarms` of this line runs on this machine; stop one of them"
            ) from error
        raise StorageError(f"{path} cannot be opened: {error}; name another folder in alarms.state_dir") from error
    except OSError as error:
        text = f"{folder} cannot be written: {error.strerror or error}; name another folder in alarms.state_dir"
        raise StorageError(text) from error


def _on_read_only_disk(folder: Path) -> bool:
    there = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    return bool(os.statvfs(there).f_flag & os.ST_RDONLY)


def _read_only(path: Path) -> sqlite3.Connection:
    """What is there and sound, to be read alone."""
    if path.is_file():
        db = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True, check_same_thread=False)
        with contextlib.suppress(sqlite3.DatabaseError):
            if db.execute("PRAGMA quick_check").fetchone() == ("ok",):
                return db
        db.close()
    db = sqlite3.connect(":memory:", check_same_thread=False)
    db.execute("PRAGMA query_only = ON")
    return db


def _set_aside(path: Path, error: Exception) -> None:
    aside = path.with_name(f"{FILE}.damaged-{time.time_ns()}")
    path.replace(aside)
    log.error("%s is damaged (%s): set aside as %s; what it held is not sent", path, error, aside.name)


def _lock(db: sqlite3.Connection) -> None:
    """Take the lock, which is kept. That needs no room; where a new file finds none, the lock is taken all the same."""
    try:
        db.execute("BEGIN EXCLUSIVE")
        db.execute("COMMIT")
    except sqlite3.OperationalError as error:
        if error.sqlite_errorcode != sqlite3.SQLITE_FULL:
            raise


def _connected(path: Path) -> sqlite3.Connection:
    db = sqlite3.connect(path, check_same_thread=False, timeout=1.0)
    try:
        db.execute("PRAGMA locking_mode = EXCLUSIVE")
        if db.execute("PRAGMA quick_check").fetchone() != ("ok",):
            raise sqlite3.DatabaseError("its pages do not fit together")
        _lock(db)
    except BaseException:
        with contextlib.suppress(sqlite3.Error):
            db.close()
        raise
    return db
