"""A link of given rate and delay between two interfaces, made of two TAP devices and a thread.

The kernel's own `netem` does the same, but many small kernels (this project's build machine among them) lack it.
"""

from __future__ import annotations

import fcntl
import os
import select
import struct
import threading
import time
from collections import deque
from typing import Self

QUEUE_BYTES = 256 * 1024
_TUNSETIFF = 0x400454CA
_IFF_TAP, _IFF_NO_PI = 0x0002, 0x1000
_LARGEST_PACKET = 65536


class _Direction:
    """Packets on their way one way: the sender's queue, then the wire."""

    def __init__(self, out: int, *, bits_per_s: float, delay_s: float) -> None:
        self.out = out
        self._bits_per_s = bits_per_s
        self._delay_s = delay_s
        self._under_way: deque[tuple[float, bytes]] = deque()
        self._free_s = 0.0
        self.dropped = 0

    def take(self, packet: bytes, now_s: float) -> None:
        """A packet enters; it is dropped where the queue is full, as a modem would."""
        backlog_s = max(0.0, self._free_s - now_s)
        if backlog_s * self._bits_per_s / 8 > QUEUE_BYTES:
            self.dropped += 1
            return
        self._free_s = max(now_s, self._free_s) + 8 * len(packet) / self._bits_per_s
        self._under_way.append((self._free_s + self._delay_s, packet))

    def deliver(self, now_s: float) -> None:
        """Whatever has arrived by now leaves at the far end."""
        while self._under_way and self._under_way[0][0] <= now_s:
            try:
                os.write(self.out, self._under_way.popleft()[1])
            except OSError:  # the far interface is down
                self.dropped += 1

    def wait_s(self, now_s: float) -> float:
        """Until the next arrival."""
        return max(0.0, self._under_way[0][0] - now_s) if self._under_way else 0.2


class SlowLink:
    """TAP devices `left` and `right` (to be moved into namespaces), joined while the `with` block lasts."""

    def __init__(self, left: str, right: str, *, bits_per_s: float, delay_s: float) -> None:
        self._names = (left, right)
        self._bits_per_s = bits_per_s
        self._delay_s = delay_s
        self._stop = threading.Event()

    def __enter__(self) -> Self:
        self._files = [_open_tap(name) for name in self._names]
        self._thread = threading.Thread(target=self._carry, name="slow-link", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        for file in self._files:
            os.close(file)

    def _carry(self) -> None:
        left, right = self._files
        shape = {"bits_per_s": self._bits_per_s, "delay_s": self._delay_s}
        ways = {left: _Direction(right, **shape), right: _Direction(left, **shape)}
        while not self._stop.is_set():
            now_s = time.monotonic()
            readable, _, _ = select.select(self._files, [], [], min(way.wait_s(now_s) for way in ways.values()))
            now_s = time.monotonic()
            for file in readable:
                try:
                    ways[file].take(os.read(file, _LARGEST_PACKET), now_s)
                except OSError:  # its interface is down, or not up yet
                    self._stop.wait(0.01)
            for way in ways.values():
                way.deliver(now_s)


def _open_tap(name: str) -> int:
    file = os.open("/dev/net/tun", os.O_RDWR)
    fcntl.ioctl(file, _TUNSETIFF, struct.pack("16sH22x", name.encode(), _IFF_TAP | _IFF_NO_PI))
    return file
