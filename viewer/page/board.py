"""The newest snapshot of every line as one text, for any number of readers. Newest wins: a slow reader skips.

Each carries `told_s`, how long ago it was put here: a watcher that hangs cannot pass old figures off as new ones. The
text says when it was made, `sent_s` by this machine's monotonic clock: what waits on a slow link is no newer either.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from typing import Any


class Board:
    """Lines in the order in which they were announced. Writers never wait for readers."""

    def __init__(self, lines: list[str]) -> None:
        self._lock = threading.Lock()
        self.on_change: Callable[[], None] = lambda: None
        self._snapshots: dict[str, tuple[float, dict[str, Any]] | None] = dict.fromkeys(lines)
        self._version = 0

    def put(self, snapshot: dict[str, Any]) -> None:
        """Replace the snapshot of the line it names."""
        with self._lock:
            self._snapshots[snapshot["line"]] = (time.monotonic(), snapshot)
            self._version += 1
        self.on_change()

    def newest(self) -> tuple[int, str]:
        """(version, JSON): what there is now; the version rises with each change."""
        with self._lock:
            number, snapshots = self._version, dict(self._snapshots)
        now_s = time.monotonic()
        lines = [
            {**found[1], "told_s": round(now_s - found[0], 1)} if found else {"line": name, "state": "starting"}
            for name, found in snapshots.items()
        ]
        told = {"lines": lines, "sent_s": round(now_s, 2)}
        return number, json.dumps(told, separators=(",", ":"), allow_nan=False)
