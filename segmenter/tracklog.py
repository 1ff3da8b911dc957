"""The camera's log: numbered entries, kept on disk until the aggregator says that they are durable in the ledger."""

from __future__ import annotations

from collections import deque
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import Self

from conveyor.errors import StorageError
from conveyor.messages import Mark, Track, TrackEntry
from conveyor.messages.tracks import UNFOLLOWED
from segmenter.log_store import LogStore
from segmenter.log_writer import LogWriter

MAX_UNCOMMITTED = 100_000
NEARLY_FULL = 0.95
"""Of that: the rest is for what was seen already when no more is looked at."""
RESEND_AFTER_S = 1.0
RESEND_AFTER_AT_MOST_S = 8.0
UNDER_WAY_AT_MOST, UNDER_WAY_AT_LEAST = 512, 16
"""Entries sent and not yet confirmed. An aggregator that is slow is not sent a whole log again and again: reading it
would take the time that it needs to confirm anything. Whenever nothing is confirmed in time, half as many are under way
from then on; each that is confirmed lets one more."""


class TrackLog:
    """Entries 1, 2, 3, ... of one camera in one run. Without a path it lives in memory and dies with the process.

    Args:
        behind: a thread of its own writes the log, and an entry is due when it is on the disk; else `append` waits.
    """

    def __init__(self, path: Path | None, *, camera: str, run: str, behind: bool = False) -> None:
        self.camera = camera
        self.run = run
        self.committed = 0
        self.last_mark: Mark | None = None
        self.store: LogStore | LogWriter | None = None if path is None else LogStore(path, camera=camera, run=run)
        if behind and isinstance(self.store, LogStore):
            self.store = LogWriter(self.store)
        self._entries: deque[TrackEntry] = deque()
        self._since_mark: list[TrackEntry] = []
        self._mark_before: TrackEntry | None = None
        self._next = 1
        self._unsent_from = 1
        self._progress_s: float | None = None
        self._patience_s = RESEND_AFTER_S
        self._under_way = UNDER_WAY_AT_MOST
        self._sent_to = 0
        self._timed: tuple[int, float] | None = None

    def __enter__(self) -> Self:
        if self.store is not None:
            self.store.__enter__()
            try:
                self._restore(self.store)
            except BaseException:
                self.store.__exit__(None, None, None)
                raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.store is not None:
            self.store.__exit__(kind, error, trace)

    @property
    def newest(self) -> int:
        """Number of the newest entry."""
        return self._next - 1

    @property
    def since_mark(self) -> list[Track]:
        """Tracks logged after the last mark."""
        return [entry.track for entry in self._since_mark if entry.track is not None]

    @property
    def speed_mps(self) -> float | None:
        """The belt's speed between the last two marks, metres per second of the camera's clock; None: not known."""
        before, last = self._mark_before.mark if self._mark_before else None, self.last_mark
        if before is None or last is None or last.captured_ns <= before.captured_ns:
            return None
        if last.frames.get(UNFOLLOWED):
            return None
        return max(0.0, (last.travel_m - before.travel_m) / (last.captured_ns - before.captured_ns) * 1e9)

    @property
    def uncommitted(self) -> int:
        """Entries the aggregator has not confirmed."""
        return len(self._entries)

    @property
    def nearly_full(self) -> bool:
        """So much waits for the aggregator that no more belt should be looked at."""
        return len(self._entries) > NEARLY_FULL * MAX_UNCOMMITTED

    @property
    def finished(self) -> bool:
        """The final mark is written and everything is committed."""
        return self.last_mark is not None and self.last_mark.final and not self._entries

    def append(self, items: list[Track | Mark]) -> None:
        """Number and store tracks and marks, all in one transaction; without a thread for it they are durable then.

        Raises:
            StorageError: too much waits for the aggregator, or the disk refuses.
        """
        if len(self._entries) + len(items) > MAX_UNCOMMITTED:
            raise StorageError(
                f"the log of camera '{self.camera}' holds {len(self._entries)} entries that the aggregator has not "
                f"committed (limit {MAX_UNCOMMITTED}): is it running, and can it write its ledger?"
            )
        entries = [self._numbered(n, item) for n, item in enumerate(items, start=self._next)]
        if self.store is not None:
            self.store.append(entries, newest=self.newest + len(entries), committed=self.committed)
        for entry in entries:
            self._entries.append(entry)
            self._note(entry)
        self._next += len(entries)

    def commit(self, n: int) -> None:
        """The aggregator has made entries 1..n durable.

        Where those are more than were written here, they are of a log that is lost, and what waits here is none of
        them: it is numbered on behind them.
        """
        if n <= self.committed:
            return
        moved = self._numbered_on(n)
        if self.store is not None:
            before = [self._mark_before] if self._mark_before else []
            keep = (entry.n for entry in [*before, *self._since_mark] if entry.n not in moved)
            self.store.commit(newest=max(self.newest, n + len(moved)), committed=n, keep=keep, moved=moved.values())
        self._under_way = min(self._under_way + n - self.committed, UNDER_WAY_AT_MOST)
        self.committed = n
        self._progress_s = None
        self._next = max(self._next, n + 1 + len(moved))
        self._take_numbers(moved)
        self._forget_committed()
        self._unsent_from = max(self._unsent_from, n + 1)

    def due(self, now_s: float) -> list[TrackEntry]:
        """Entries to send now: the new ones; those under way once more when nothing was confirmed for a while."""
        self._learn_patience(now_s)
        if self._progress_s is None or not self._entries:
            self._progress_s = now_s
        if now_s - self._progress_s >= self._patience_s:
            self._progress_s, self._timed = now_s, None
            self._patience_s = min(2 * self._patience_s, RESEND_AFTER_AT_MOST_S)
            self._under_way = max(self._under_way // 2, UNDER_WAY_AT_LEAST)
            self.resend()
        durable = self.store.durable if isinstance(self.store, LogWriter) else self.newest
        until = min(durable, self.committed + self._under_way)
        if not self._entries or self._unsent_from > until:
            return []
        first = self._entries[0].n
        self._unsent_from, unsent_from = until + 1, max(first, self._unsent_from)
        if until > self._sent_to:
            self._sent_to, self._timed = until, self._timed or (until, now_s)
        return list(islice(self._entries, unsent_from - first, until + 1 - first))

    def _learn_patience(self, now_s: float) -> None:
        """Twice what the aggregator took to confirm an entry that was sent once: it may be slow, and get everything."""
        if self._timed is not None and self.committed >= self._timed[0]:
            took_s = now_s - self._timed[1]
            self._patience_s = min(max(RESEND_AFTER_S, 2 * took_s), RESEND_AFTER_AT_MOST_S)
            self._timed = None

    def resend(self) -> None:
        """Send what is uncommitted again from the next `due` on: the aggregator came back."""
        if self._entries:
            self._unsent_from = self._entries[0].n

    def _restore(self, store: LogStore | LogWriter) -> None:
        stored = store.load()
        self.committed = stored.committed
        self._next = stored.newest + 1
        for entry in stored.entries:
            self._entries.append(entry)
            self._note(entry)
        self._forget_committed()
        self._unsent_from = self.committed + 1

    def _numbered(self, n: int, item: Track | Mark) -> TrackEntry:
        track, mark = (item, None) if isinstance(item, Track) else (None, item)
        return TrackEntry(camera=self.camera, run=self.run, n=n, track=track, mark=mark)

    def _numbered_on(self, n: int) -> dict[int, TrackEntry]:
        """What waits as n + 1, n + 2, ..., by the number that it has now; nothing where n is a number of this log."""
        if n <= self.newest:
            return {}
        waiting = ((entry.n, entry.track or entry.mark) for entry in self._entries)
        return {was: self._numbered(now, item) for now, (was, item) in enumerate(waiting, start=n + 1) if item}

    def _take_numbers(self, moved: dict[int, TrackEntry]) -> None:
        """Entries under the numbers that they were `moved` to."""
        if not moved:
            return
        self._entries = deque(moved.values())
        self._since_mark = [moved.get(entry.n, entry) for entry in self._since_mark]
        if self._mark_before is not None:
            self._mark_before = moved.get(self._mark_before.n, self._mark_before)

    def _forget_committed(self) -> None:
        while self._entries and self._entries[0].n <= self.committed:
            self._entries.popleft()

    def _note(self, entry: TrackEntry) -> None:
        """A process that starts again needs the last two marks and what came after them, committed or not."""
        if entry.mark is not None:
            if self._since_mark and self._since_mark[0].mark is not None:
                self._mark_before = self._since_mark[0]
            self.last_mark = entry.mark
            self._since_mark = []
        self._since_mark.append(entry)
