"""The bounded queue between the scene and a sink: putting never waits, whatever the sink does.

Two kinds of room. Heavy entries (pictures, clouds) have one slot per path and the newest wins; light ones (weights,
totals, log) a queue in order, whose oldest give way when it is full; not what always holds, or that another run begins:
that is said once, and later entries cannot be drawn without it. Every loss is counted, and at any moment
offered = taken + dropped_superseded + dropped_full + waiting.
"""

from __future__ import annotations

import threading
from collections import deque

from conveyor.counters import CounterSet
from viewer.scene.primitives import Entry, NewRun

LIGHT_CAPACITY = 16384
HEAVY_CAPACITY = 256


class Outbox:
    """See the module. `name` prefixes the counters, e.g. 'file' or 'hub'."""

    def __init__(
        self,
        *,
        name: str,
        counters: CounterSet,
        light_capacity: int = LIGHT_CAPACITY,
        heavy_capacity: int = HEAVY_CAPACITY,
    ) -> None:
        self._name = name
        self._counters = counters
        self._light_capacity = light_capacity
        self._heavy_capacity = heavy_capacity
        self._light: deque[Entry] = deque()
        self._heavy: dict[str, Entry] = {}
        self._arrived = threading.Condition()
        for what in ("offered", "dropped_superseded", "dropped_full"):
            counters.add(f"{name}_{what}", 0)

    def put(self, entry: Entry) -> None:
        """Take `entry` over, in microseconds."""
        with self._arrived:
            reason, lost = self._make_room(entry)
            if entry.heavy:
                self._heavy[entry.path] = entry
            else:
                self._light.append(entry)
            waiting = len(self._light) + len(self._heavy)
            self._arrived.notify()
        self._counters.add(f"{self._name}_offered")
        if lost:
            self._counters.add(f"{self._name}_dropped_{reason}", lost)
        self._counters.gauge(f"{self._name}_waiting", waiting)

    def take(self, timeout_s: float) -> list[Entry]:
        """Everything that waits, light entries in order and then the heavy ones; [] when nothing came in time."""
        with self._arrived:
            if not self._light and not self._heavy:
                self._arrived.wait(timeout_s)
            batch = [*self._light, *self._heavy.values()]
            self._light.clear()
            self._heavy.clear()
        self._counters.gauge(f"{self._name}_waiting", 0)
        return batch

    def wake(self) -> None:
        """Let a waiting `take` return at once."""
        with self._arrived:
            self._arrived.notify_all()

    def _make_room(self, entry: Entry) -> tuple[str, int]:
        """(reason, how many) of what has to go for `entry`; the lock is held."""
        if isinstance(entry.primitive, NewRun):  # pictures of the old run must not be drawn into the new one
            lost = len(self._heavy)
            self._heavy.clear()
            return "superseded", lost
        if not entry.heavy:
            if len(self._light) < self._light_capacity:
                return "", 0
            # Of no moment: lenses, poses, another run. They are few, one for each path.
            del self._light[next((n for n, waiting in enumerate(self._light) if waiting.moment is not None), 0)]
            return "full", 1
        if self._heavy.pop(entry.path, None) is not None:
            return "superseded", 1
        if len(self._heavy) < self._heavy_capacity:
            return "", 0
        self._heavy.pop(next(iter(self._heavy)))
        return "full", 1
