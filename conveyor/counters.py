"""Counts that only grow and levels that move, shared by the threads of one process."""

from __future__ import annotations

import threading

MOST_NAMES = 256
"""Counters, and levels: a report holds no more of each (`conveyor.ranges.Sheet`)."""
FULL = "counters_refused_full"
"""What was counted under names for which there is no room."""


class CounterSet:
    """Thread-safe named counters (monotonic) and gauges (levels), `MOST_NAMES` of each at most."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._values: dict[str, int] = {}
        self._gauges: dict[str, float] = {}

    def add(self, name: str, n: int = 1) -> None:
        """Count `n` more of `name`; n = 0 makes the counter visible before anything happened."""
        with self._lock:
            if name not in self._values and len(self._values) >= MOST_NAMES - 1:
                name = FULL
            self._values[name] = self._values.get(name, 0) + n

    def gauge(self, name: str, value: float) -> None:
        """Set the level `name`."""
        with self._lock:
            if name not in self._gauges and len(self._gauges) >= MOST_NAMES:
                self._values[FULL] = self._values.get(FULL, 0) + 1
                return
            self._gauges[name] = float(value)

    def forget_gauges(self) -> None:
        """Drop all levels: what they were levels of is over."""
        with self._lock:
            self._gauges.clear()

    def get(self, name: str) -> int:
        """The count of `name`, 0 where it never happened."""
        with self._lock:
            return self._values.get(name, 0)

    def snapshot(self) -> tuple[dict[str, int], dict[str, float]]:
        """(counts, levels) at one moment."""
        with self._lock:
            return dict(self._values), dict(self._gauges)


def is_told(n: int) -> bool:
    """Whether the `n`-th of many like events is logged: 1, 2, 4, 8 ...: told, and never a flood."""
    return n & (n - 1) == 0
