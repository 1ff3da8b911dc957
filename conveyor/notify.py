"""systemd's notification protocol: one datagram to the socket it names; nothing without systemd."""

from __future__ import annotations

import os
import socket


def notify(state: str) -> None:
    """Tell systemd `state`, e.g. 'READY=1' or 'WATCHDOG=1' (sd_notify(3))."""
    address = os.environ.get("NOTIFY_SOCKET")
    if not address:
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as channel:
        channel.sendto(state.encode(), "\0" + address[1:] if address.startswith("@") else address)
