"""The camera's log written by a thread of its own: frames do not wait for the disk.

A disk answers in 2 ms as a rule and in 60 now and then, and a log that is written with every frame would lose frames by
that. Entries are still on the disk before they are sent: `durable` says how far. What comes while the disk is busy goes
into the next transaction, all of it.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from conveyor.messages import TrackEntry
from segmenter.log_store import LogStore, StoredLog

LEAVE_WITHIN_S = 1.5
"""A disk that does not answer keeps no process alive; what was not written was not sent either."""


@dataclass(frozen=True, slots=True)
class _Append:
    entries: tuple[TrackEntry, ...]
    newest: int
    committed: int


@dataclass(frozen=True, slots=True)
class _Commit:
    newest: int
    committed: int
    keep: tuple[int, ...]
    moved: tuple[TrackEntry, ...] = ()


class LogWriter:
    """A `LogStore` that returns at once. What went wrong is raised by the next call.

    Attributes:
        durable: entries up to this number are on the disk.
    """

    def __init__(self, store: LogStore) -> None:
        self._store = store
        self._waiting: deque[_Append | _Commit] = deque()
        self._changed = threading.Condition()
        self._leaving = False
        self._error: BaseException | None = None
        self._thread: threading.Thread | None = None
        self.durable = 0

    def __enter__(self) -> Self:
        self._store.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Write what waits, then close the file.

        Raises:
            StorageError: it could not be written.
        """
        with self._changed:
            self._leaving = True
            self._changed.notify()
        if self._thread is not None:
            self._thread.join(LEAVE_WITHIN_S)
            if self._thread.is_alive():
                return
        self._store.__exit__(kind, error, trace)
        if error is None:
            self._raise_error()

    def load(self) -> StoredLog:
        """Everything the file holds; to be called before anything is written."""
        stored = self._store.load()
        self.durable = stored.newest
        return stored

    def append(self, entries: Iterable[TrackEntry], *, newest: int, committed: int) -> None:
        """Store entries, soon; `durable` tells when they are on the disk."""
        self._put(_Append(tuple(entries), newest, committed))

    def commit(self, *, newest: int, committed: int, keep: Iterable[int], moved: Iterable[TrackEntry] = ()) -> None:
        """The aggregator has made entries up to `committed` durable: forget them, but for those to `keep`.

        Entries `moved` to numbers behind `committed` take the places of those that wait.
        """
        self._put(_Commit(newest, committed, tuple(keep), tuple(moved)))

    def _put(self, job: _Append | _Commit) -> None:
        self._raise_error()
        with self._changed:
            self._waiting.append(job)
            if self._thread is None:
                self._thread = threading.Thread(target=self._write, name="log", daemon=True)
                self._thread.start()
            self._changed.notify()

    def _raise_error(self) -> None:
        if self._error is not None:
            raise self._error

    def _write(self) -> None:
        try:
            while (jobs := self._take()) is not None:
                self._write_all(jobs)
        except BaseException as error:
            self._error = error

    def _take(self) -> list[_Append | _Commit] | None:
        """Everything that waits; None at the end."""
        with self._changed:
            while not self._waiting and not self._leaving:
                self._changed.wait()
            jobs = list(self._waiting)
            self._waiting.clear()
            return jobs or None

    def _write_all(self, jobs: list[_Append | _Commit]) -> None:
        """In order, as few transactions as can be: entries that are moved are written before any that follow them."""
        start = 0
        for n, job in enumerate(jobs, start=1):
            if n == len(jobs) or (isinstance(job, _Commit) and job.moved):
                self._write_some(jobs[start:n])
                start = n

    def _write_some(self, jobs: list[_Append | _Commit]) -> None:
        """All entries in one transaction; of what was committed the last word is enough."""
        appends = [job for job in jobs if isinstance(job, _Append)]
        commits = [job for job in jobs if isinstance(job, _Commit)]
        if appends:
            last = appends[-1]
            entries = (entry for job in appends for entry in job.entries)
            self._store.append(entries, newest=last.newest, committed=last.committed)
            self.durable = last.newest
        if commits:
            job = commits[-1]
            newest = max(job.newest, self.durable)
            self._store.commit(newest=newest, committed=job.committed, keep=job.keep, moved=job.moved)
            if job.moved:
                self.durable = newest
