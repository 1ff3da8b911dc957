"""Where entries go. Each sink has its own thread, queue and recording, so that none waits for another.

Rerun's SDK blocks when a hub or a viewer is slow, and has no connection state (measured on 0.41). Hence: a thread that
calls `offer` only fills a bounded queue, one batch at a time is under way, and `join` gives up on a thread that hangs.
At any moment: taken from the queue = sent + dropped_<reason> + the batch under way.
"""

from __future__ import annotations

import logging
import threading
from abc import ABC, abstractmethod

from conveyor.counters import CounterSet
from viewer.outbox import Outbox
from viewer.scene.primitives import Entry, NewRun, Primitive

IDLE_S = 1.0


class Sink(ABC):
    """A queue and the thread that empties it. Subclasses know how to open, to draw and to finish a batch.

    Attributes:
        given_up_after: faults after which the others go on without it; any other one ends the process.
    """

    given_up_after: tuple[type[Exception], ...] = ()

    def __init__(self, name: str, *, run: str, tick_s: float, counters: CounterSet, log: logging.Logger) -> None:
        self.name = name
        self._run_id = run
        self._tick_s = tick_s
        self._counters = counters
        self._log = log
        self._outbox = Outbox(name=name, counters=counters)
        self._stop = threading.Event()
        self._closed = threading.Event()
        self._statics: dict[str, Entry] = {}
        self._under_way = 0
        self._thread = threading.Thread(target=self._main, name=f"sink-{name}", daemon=True)
        for what in ("sent", "dropped_link", "dropped_failed"):
            counters.add(f"{name}_{what}", 0)

    def offer(self, entry: Entry) -> None:
        """Queue `entry`; never waits."""
        self._outbox.put(entry)

    def start(self) -> None:
        """Start the thread; it opens the sink."""
        self._thread.start()

    def ask_stop(self) -> None:
        """Tell the thread to finish what waits and to end."""
        self._stop.set()
        self._outbox.wake()

    def join(self, timeout_s: float) -> bool:
        """Wait for the end; False when the thread hangs and the process has to be left by `os._exit`."""
        self._thread.join(timeout_s)
        return self._closed.is_set()

    def _main(self) -> None:
        try:
            self._work()
        except self.given_up_after:
            self._log.exception("%s sink failed; the viewer goes on without it", self.name)
            self._counters.add(f"{self.name}_dropped_failed", self._under_way)
            self._discard_until_stop()
        self._closed.set()

    @abstractmethod
    def _work(self) -> None:
        """Open, then take batches and finish them until stopped."""

    def _discard_until_stop(self) -> None:
        while not self._stop.is_set():
            self._counters.add(f"{self.name}_dropped_failed", len(self._outbox.take(IDLE_S)))

    def _draw(self, entry: Entry) -> None:
        """Draw one entry; one that cannot be drawn is counted and does not take the others with it."""
        primitive: Primitive = entry.primitive
        if entry.moment is None and not isinstance(primitive, NewRun):
            self._statics[entry.path] = entry
        try:
            if isinstance(primitive, NewRun):
                self._statics.clear()
                self._switch_run(primitive.run)
            else:
                self._put(entry)
        except (ValueError, TypeError, OverflowError) as error:
            self._counters.add(f"{self.name}_undrawable")
            self._log.error("%s cannot be drawn at %s: %s", type(primitive).__name__, entry.path, error)

    @abstractmethod
    def _put(self, entry: Entry) -> None:
        """Draw one entry of the run."""

    @abstractmethod
    def _switch_run(self, run: str) -> None:
        """End what was begun for the run before and begin again for `run`."""
