"""A process's own time: a steady clock that stands still while the process has work and is given no processor.

What stands back on a busy machine, as regressors do, needs minutes to start where it needs seconds else. By this clock
it needs the same seconds: so what is slow is told from what does not move.
"""

from __future__ import annotations

from pathlib import Path

PROC = Path("/proc")


class OwnTime:
    """The time of the process `pid`. Where the kernel does not tell who waits (not Linux), it is the time of all."""

    def __init__(self, pid: int) -> None:
        self._file = PROC / str(pid) / "schedstat"
        self._waited_s = 0.0

    def look(self) -> float:
        """Ask the kernel how long the process has waited; returns how much longer than when last asked, seconds."""
        before, self._waited_s = self._waited_s, max(self._waited_s, self._told_s())
        return self._waited_s - before

    def at(self, now_s: float) -> float:
        """What its clock shows at `now_s` of the monotonic clock; they were equal when it was started."""
        return now_s - self._waited_s

    def _told_s(self) -> float:
        """Of its main thread, which starts it and turns its loop: run, waited (nanoseconds), how often."""
        try:
            return int(self._file.read_text().split()[1]) / 1e9
        except (OSError, IndexError, ValueError):
            return 0.0
