"""The process that joins two TAP devices by an emulated link: one thread, one epoll loop. Started by `benchmarks.link`.

    python -m benchmarks.link_emulator LEFT RIGHT SEED        # as root

Says `{}` when both devices are there. Each line on stdin is a JSON object: link settings to change from now on, none to
change nothing; the answer is a line with the counts of both directions. Ends, and its devices with it, when stdin does.
"""

from __future__ import annotations

import fcntl
import json
import os
import select
import struct
import sys
import time
from contextlib import suppress
from dataclasses import asdict, replace
from typing import Any

from benchmarks.link_wire import LinkSettings, Wire

TUNSETIFF = 0x400454CA
IFF_TAP, IFF_NO_PI = 0x0002, 0x1000
LARGEST_PACKET = 65536
MOST_AT_ONCE = 64
"""Packets read from one device before the other one has its turn."""


def run(left: str, right: str, seed: int) -> None:
    """Carry packets between the devices until stdin ends."""
    with suppress(PermissionError):
        os.nice(-10)  # a wire does not wait for other work on the machine
    taps = [_open_tap(name) for name in (left, right)]
    wires = {taps[0]: Wire(LinkSettings(), seed=2 * seed), taps[1]: Wire(LinkSettings(), seed=2 * seed + 1)}
    far_end = {taps[0]: taps[1], taps[1]: taps[0]}
    control = sys.stdin.fileno()
    poll = select.epoll()
    for file in (*taps, control):
        poll.register(file, select.EPOLLIN)
    _say({})
    asleep_s: dict[int, float] = {}
    while True:
        timeout_s = _until_next(list(wires.values()), asleep_s)
        ready = [file for file, _ in poll.poll(timeout_s)]
        if control in ready:
            line = sys.stdin.buffer.readline()
            if not line:
                return
            _obey(json.loads(line), wires)
        for tap in taps:
            if tap in ready and not _drain(tap, wires[tap]):
                poll.unregister(tap)  # its interface is not up: it would be ready all the time
                asleep_s[tap] = time.monotonic() + 0.05
        _wake(poll, asleep_s)
        now_s = time.monotonic()
        for tap, wire in wires.items():
            for packet in wire.due(now_s):
                wire.handed_over(packet, taken=_write(far_end[tap], packet))


def _drain(tap: int, wire: Wire) -> bool:
    """Take what waits at a device; False where its interface is down."""
    for _ in range(MOST_AT_ONCE):
        try:
            packet = os.read(tap, LARGEST_PACKET)
        except BlockingIOError:
            return True
        except OSError:
            return False
        wire.take(packet, time.monotonic())
    return True


def _write(tap: int, packet: bytes) -> bool:
    try:
        os.write(tap, packet)
    except OSError:  # the far interface is down, or full
        return False
    return True


def _until_next(wires: list[Wire], asleep_s: dict[int, float]) -> float:
    """Seconds until something is to do by itself."""
    moments = [wire.next_due_s for wire in wires if wire.next_due_s is not None] + list(asleep_s.values())
    return max(0.0, min(moments) - time.monotonic()) if moments else -1.0


def _wake(poll: select.epoll, asleep_s: dict[int, float]) -> None:
    for tap in [tap for tap, until_s in asleep_s.items() if until_s <= time.monotonic()]:
        del asleep_s[tap]
        poll.register(tap, select.EPOLLIN)


def _obey(change: dict[str, Any], wires: dict[int, Wire]) -> None:
    for wire in wires.values():
        wire.settings = replace(wire.settings, **change)
    _say([asdict(wire.counts) for wire in wires.values()])


def _say(answer: object) -> None:
    sys.stdout.write(json.dumps(answer) + "\n")
    sys.stdout.flush()


def _open_tap(name: str) -> int:
    file = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(file, TUNSETIFF, struct.pack("16sH22x", name.encode(), IFF_TAP | IFF_NO_PI))
    return file


if __name__ == "__main__":
    run(sys.argv[1], sys.argv[2], int(sys.argv[3]))
