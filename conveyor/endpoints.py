"""A router's endpoint, as 'tls/edge:7447' or 'tcp/[::1]:7447#iface=eth0', taken apart; and whether its port answers."""

from __future__ import annotations

import re
import socket


def host_and_port(endpoint: str) -> tuple[str, str]:
    """(host, port) as they are written, an IPv6 host in its brackets; '' for what is not there."""
    host, _, port = re.split("[?#]", endpoint.partition("/")[2])[0].rpartition(":")
    return host, port


def takes_connections(host: str, port: int, *, within_s: float) -> bool:
    """Whether somebody takes connections there, a router or another program."""
    try:
        socket.create_connection((host.strip("[]"), port), timeout=within_s).close()
    except (OSError, UnicodeError):  # a name that is too long is no OSError
        return False
    return True
