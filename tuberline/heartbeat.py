"""What a supervised process says of itself, by systemd's notification protocol: that it starts, is ready, and moves.

A node says WATCHDOG=1 while its loop turns (`conveyor.node`), for systemd and for the supervisor of `tuberline run` and
`replay` alike. While it starts, a thread of it says that it is there (`tuberline.orphan`). A signal that ends it makes
it say STOPPING=1: what has finished its work does not.
"""

from __future__ import annotations

import itertools
import os
import socket

STILL_AFTER_S = 20.0
"""As WatchdogSec of the systemd units. A node's loop that stands still is silent after 5 s already."""
START_WITHIN_S = 300.0
"""As TimeoutStartSec: on the very first start numba compiles."""
LARGEST = 4096
_numbers = itertools.count()


class Heartbeat:
    """Listens to one process. `environment` tells it where; without abstract sockets (not Linux) nothing is watched.

    Args:
        now_s: the monotonic clock.
        patience: times `STILL_AFTER_S` it may stand still, and times `START_WITHIN_S` it may take to start.
    """

    def __init__(self, now_s: float, *, patience: float = 1.0) -> None:
        self._still_after_s = patience * STILL_AFTER_S
        self.environment: dict[str, str] = {"NOTIFY_SOCKET": ""}
        self._channel: socket.socket | None = None
        self._ready = False
        self._told_to_end = False
        self._heard_s = now_s
        self._start_until_s = now_s + patience * START_WITHIN_S
        name = f"tuberline-{os.getpid()}-{next(_numbers)}"
        channel = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC)
        try:
            channel.bind(f"\0{name}")
        except OSError:
            channel.close()
            return
        self._channel = channel
        self.environment = {"NOTIFY_SOCKET": f"@{name}"}

    def close(self) -> None:
        """Listen no longer."""
        if self._channel is not None:
            self._channel.close()
            self._channel = None

    def forgive(self, now_s: float) -> None:
        """Start counting again: no one could listen for a while."""
        self._heard_s = now_s
        self._start_until_s = max(self._start_until_s, now_s + self._still_after_s)

    def told_to_end(self, now_s: float) -> bool:
        """Somebody ended the process by a signal that it listens to."""
        self._listen(now_s)
        return self._told_to_end

    def standstill(self, now_s: float) -> str:
        """Take what the process said; in words for how long it has stood still, empty while it has not for too long."""
        self._listen(now_s)
        if self._channel is None:
            return ""
        if now_s - self._heard_s > self._still_after_s:
            return f"has stood still for {now_s - self._heard_s:.0f} s"
        if not self._ready and now_s > self._start_until_s:
            return "takes too long to start"
        return ""

    def _listen(self, now_s: float) -> None:
        while self._channel is not None:
            try:
                said = self._channel.recv(LARGEST).decode(errors="replace").splitlines()
            except OSError:  # nothing more
                return
            for line in said:
                self._take(line, now_s)

    def _take(self, line: str, now_s: float) -> None:
        key, _, value = line.partition("=")
        if key == "READY":
            self._ready = True
        if key == "STOPPING":
            self._told_to_end = True
        if key == "EXTEND_TIMEOUT_USEC" and value.isdecimal():
            self._start_until_s = max(self._start_until_s, now_s + int(value) / 1e6)
        if key in ("READY", "WATCHDOG", "EXTEND_TIMEOUT_USEC") or not self._ready:
            self._heard_s = now_s
