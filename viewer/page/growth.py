"""How fast a node's counters grow, and for how long: a drop counter that stands still is history, one that grows is
trouble now.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from conveyor.messages import Counters

WINDOW_S = 6.0
PAUSE_S = 3.5
"""Reports come once a second; a counter that grew in neither of the last three rests."""
MAX_COUNTERS = 256


@dataclass(slots=True)
class _Climb:
    """When a counter first was seen, began to grow and grew last. What falls back and rises again does not grow: a
    frame under way counts as missing until it arrives.
    """

    seen_s: float
    highest: float
    began_s: float | None = None
    last_s: float | None = None


@dataclass(slots=True)
class Growth:
    """The last reports of one node. A restart or a new run counts from zero and starts this again."""

    _reports: deque[tuple[float, dict[str, float]]] = field(default_factory=deque)
    _climbs: dict[str, _Climb] = field(default_factory=dict)
    _who: tuple[int, str] | None = None

    def add(self, report: Counters, now_s: float) -> None:
        """Take a new report."""
        if self._who != (report.pid, report.run):
            self._who = (report.pid, report.run)
            self._reports.clear()
            self._climbs.clear()
        counted = dict(list({**report.gauges, **report.values}.items())[:MAX_COUNTERS])
        for name, value in counted.items():
            if name not in self._climbs and len(self._climbs) >= MAX_COUNTERS:
                continue
            climb = self._climbs.setdefault(name, _Climb(now_s, highest=0.0 if self._reports else value))
            if value > climb.highest:
                climb.highest = value
                if climb.last_s is None or now_s - climb.last_s > PAUSE_S:
                    climb.began_s = now_s
                climb.last_s = now_s
        self._reports.append((now_s, counted))
        while len(self._reports) > 2 and self._reports[0][0] < now_s - WINDOW_S:
            self._reports.popleft()

    def lowest(self) -> dict[str, float]:
        """The lowest value of each counter in the window."""
        last = self._reports[-1][1] if self._reports else {}
        return {name: min(counted.get(name, 0.0) for _, counted in self._reports) for name in last}

    def per_s(self) -> dict[str, float]:
        """What grew per second over the window; empty before the second report."""
        if len(self._reports) < 2:
            return {}
        (first_s, first), (last_s, last) = self._reports[0], self._reports[-1]
        seconds = last_s - first_s
        return {} if seconds <= 0 else {name: (last[name] - first.get(name, 0.0)) / seconds for name in last}

    def growing_s(self, now_s: float) -> dict[str, float]:
        """For how long each counter has been growing, of those that grow."""
        return {
            name: now_s - climb.began_s
            for name, climb in self._climbs.items()
            if climb.began_s is not None and climb.last_s is not None and now_s - climb.last_s <= PAUSE_S
        }

    def resting_s(self, now_s: float) -> dict[str, float]:
        """How long ago each counter grew last; since it was first seen where it never did."""
        return {name: now_s - (climb.last_s or climb.seen_s) for name, climb in self._climbs.items()}
