"""The balance sheet of a camera's frames: published = received + gaps, received = processed + drops by reason."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from conveyor.reasons import FrameDrop


@dataclass(slots=True)
class FrameBalance:
    """Counts of one run. Sequence numbers arrive in order; what is not newer than the newest is a duplicate and changes
    nothing but its own count. Neither does what is `ahead` of a frame that its camera will send again.
    """

    first_seq: int | None = None
    newest_seq: int = -1
    last_published_seq: int = -1
    processed: int = 0
    duplicates: int = 0
    ahead: int = 0
    dropped: Counter[str] = field(default_factory=Counter)
    _overwritten: int = 0

    def known_range(self, first_seq: int | None, last_seq: int | None) -> None:
        """What the camera says that it published."""
        if first_seq is not None and (self.first_seq is None or first_seq < self.first_seq):
            self.first_seq = first_seq
        if last_seq is not None:
            self.last_published_seq = max(self.last_published_seq, last_seq)

    def receive(self, seq: int, *, after_seq: int | None = None) -> bool:
        """Note a frame's arrival; False for a duplicate, or where the frame `after_seq` is still to come."""
        if seq <= self.newest_seq:
            self.duplicates += 1
            return False
        if after_seq is not None and after_seq != self.newest_seq:
            self.ahead += 1
            return False
        if self.newest_seq >= 0:
            self._book_overwritten(seq - self.newest_seq - 1)
        else:  # what else was overwritten until now were no frames after this one
            self._book_overwritten(max(0, seq - self.first_seq) if self.first_seq is not None else 0)
            self._overwritten = 0
        self.newest_seq = seq
        self.known_range(seq, seq)
        return True

    def overwritten(self, n: int) -> None:
        """The receiving ring has overwritten `n` more messages; those that were frames show as skipped numbers."""
        self._overwritten += n

    def _book_overwritten(self, skipped: int) -> None:
        """Skipped frames that the ring overwrote did arrive: they are our drops, not gaps of the link."""
        booked = min(skipped, self._overwritten)
        if booked:
            self.dropped[FrameDrop.OVERWRITTEN] += booked
            self._overwritten -= booked

    @property
    def received(self) -> int:
        """Frames that arrived, each once."""
        return self.processed + self.dropped.total()

    @property
    def published(self) -> int:
        """Frames there were, as far as known: a sequence number that never came was a frame too."""
        return 0 if self.first_seq is None else self.last_published_seq - self.first_seq + 1

    @property
    def gaps(self) -> int:
        """Frames that never arrived."""
        return self.published - self.received

    def report(self) -> dict[str, int]:
        """The sheet as it goes into marks."""
        drops = {f"dropped_{reason}": n for reason, n in sorted(self.dropped.items())}
        return {
            "published": self.published,
            "received": self.received,
            "processed": self.processed,
            "gaps": self.gaps,
            **drops,
        }

    def resume(self, report: dict[str, int], first_seq: int) -> None:
        """Carry on from the sheet of an earlier process of the same run, which began at `first_seq`."""
        self.first_seq = first_seq
        self.processed = report.get("processed", 0)
        for name, n in report.items():
            if name.startswith("dropped_"):
                self.dropped[name.removeprefix("dropped_")] = n
        self.newest_seq = self.last_published_seq = first_seq + report.get("published", 0) - 1
