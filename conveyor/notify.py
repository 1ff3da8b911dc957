"""systemd's notification protocol: one datagram to the socket it names. `tuberline run` and `replay` speak it too."""

from __future__ import annotations

import contextlib
import os
import socket


def notify(state: str) -> None:
    """Tell the service manager `state`, e.g. 'READY=1' or 'WATCHDOG=1' (sd_notify(3)); nothing without one.

    What it does not take now is left out: a manager that is gone or stands still must not hold up a node.
    """
    address = os.environ.get("NOTIFY_SOCKET")
    if not address:
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as channel:
        channel.setblocking(False)
        with contextlib.suppress(OSError):
            channel.sendto(state.encode(), "\0" + address[1:] if address.startswith("@") else address)


def still_starting(seconds: float) -> None:
    """Starting is fine so far, and takes up to `seconds` more."""
    notify(f"EXTEND_TIMEOUT_USEC={round(seconds * 1e6)}")
