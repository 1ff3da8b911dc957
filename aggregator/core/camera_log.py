"""One camera's log as the aggregator takes it: entry n only after n - 1, each once, gaps waited for and counted."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum

from conveyor.errors import MessageError
from conveyor.messages import TrackEntry
from conveyor.wire import read_header

WAITING_ENTRIES = 4096
"""Entries held while an earlier one is missing; what comes beyond is dropped, and sent again by the segmenter."""


class Taken(StrEnum):
    """What became of an entry; the names are the counters'."""

    APPLIED = "entries_applied"
    DUPLICATE = "entries_duplicate"
    CONFLICTING = "entries_conflicting"
    WAITING = "entries_waited"
    WAITING_FULL = "entries_dropped_waiting_full"
    OTHER_RUN = "entries_refused_other_run"
    UNKNOWN_CAMERA = "entries_refused_unknown_camera"
    MALFORMED = "entries_refused_malformed"
    SET_ASIDE = "entries_set_aside"


@dataclass(frozen=True, slots=True)
class LoggedEntry:
    """An entry with its bytes, as it goes into the ledger.

    One that could not be read is here too, with neither track nor mark: its number is used up, so that the log goes on,
    and its bytes are kept. `refused` says why; empty for the others. `ends`: it was the final mark, nothing follows it.
    """

    entry: TrackEntry
    payload: bytes
    refused: str = ""
    ends: bool = False


@dataclass(slots=True)
class CameraLog:
    """The state of one camera's log: entries 1 to `applied` are applied. `fresh` holds the checksums of those that are
    not in the ledger yet; of the others the ledger knows.
    """

    applied: int = 0
    waiting: dict[int, LoggedEntry] = field(default_factory=dict)
    fresh: dict[int, int] = field(default_factory=dict)

    def take(self, entry: TrackEntry, committed: Callable[[int], int | None]) -> tuple[Taken, list[LoggedEntry]]:
        """What became of `entry`, and the entries that can be applied now, in order.

        An entry that came before with other contents is a fault of the sender (its log was lost and begun again); the
        first one stays.

        Args:
            committed: the checksum of an entry that the ledger holds, by its number.
        """
        if entry.n < 1 or (entry.track is None) == (entry.mark is None):
            return Taken.MALFORMED, []
        return self.put(LoggedEntry(entry, entry.encode()), committed)

    def put(self, logged: LoggedEntry, committed: Callable[[int], int | None]) -> tuple[Taken, list[LoggedEntry]]:
        """Like `take`, for an entry with its bytes, or what was set aside in its place."""
        entry, payload = logged.entry, logged.payload
        if entry.n <= self.applied:
            known = self.fresh[entry.n] if entry.n in self.fresh else committed(entry.n)
            return (Taken.DUPLICATE if known == zlib.crc32(payload) else Taken.CONFLICTING), []
        if entry.n in self.waiting:
            return (Taken.DUPLICATE if self.waiting[entry.n].payload == payload else Taken.CONFLICTING), []
        if entry.n > self.applied + 1:
            if len(self.waiting) >= WAITING_ENTRIES:
                return Taken.WAITING_FULL, []
            self.waiting[entry.n] = logged
            return Taken.WAITING, []
        ready = [logged]
        while (following := self.waiting.pop(entry.n + len(ready), None)) is not None:
            ready.append(following)
        self.applied += len(ready)
        self.fresh.update({logged.entry.n: zlib.crc32(logged.payload) for logged in ready})
        return Taken.APPLIED, ready


def set_aside(payload: bytes, error: MessageError) -> LoggedEntry | None:
    """What takes the place of an entry whose bytes were refused; None where not even its number can be read.

    Then nothing is lost by waiting: a log that no one here can read, of another release say, stays with its segmenter.
    """
    try:
        header = read_header(payload)
        fields = header.fields
        place = TrackEntry(camera=fields.get("camera", ""), run=fields.get("run", ""), n=fields.get("n", 0))
        place.check()
    except MessageError:
        return None
    if header.kind != TrackEntry.__name__:
        return None
    mark = fields.get("mark")
    ends = isinstance(mark, dict) and mark.get("final") is True
    return LoggedEntry(place, payload, refused=str(error.reason), ends=ends)
