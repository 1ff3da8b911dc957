"""What a process does when it is told to end, on a thread of its own.

A handler interrupts the main thread wherever it is, also where that holds the lock of the very event it waits for:
a handler that set the event would wait for its own thread, for ever.
"""

from __future__ import annotations

import queue
import signal
import threading
from collections.abc import Callable

from conveyor.notify import notify


def when_told_to_end(act: Callable[[int], None]) -> None:
    """From here on SIGTERM and Ctrl-C call `act` with their number, on another thread, which may take any lock; the
    manager hears first that this process was told to end: it did not finish.

    Call it in the main thread.
    """
    told: queue.SimpleQueue[int] = queue.SimpleQueue()  # its `put` is the one that a handler may call

    def watch() -> None:
        while True:
            number = told.get()
            notify("STOPPING=1")
            act(number)

    threading.Thread(target=watch, name="told", daemon=True).start()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda number, _frame: told.put(number))


def stop_when_told(stop: threading.Event) -> None:
    """SIGTERM and Ctrl-C set `stop`, as `when_told_to_end` says."""
    when_told_to_end(lambda _number: stop.set())
