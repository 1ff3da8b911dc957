"""The Zenoh session: every process is a client of a router; explicit endpoints, no multicast, no shared memory.

Star topology because since Zenoh 1.9 peers never relay for each other; shared memory off because receivers leak locked
memory when a publisher restarts and lose frames silently under container limits (both measured, docs/design.md).
"""

from __future__ import annotations

import json
import socket
from typing import Any

import zenoh

from conveyor.config import LinkConfig
from conveyor.errors import LinkError


def open_client(link: LinkConfig, *, name: str) -> zenoh.Session:
    """A client session to the line's router; close it (`with`) or the interpreter hangs at exit.

    Raises:
        LinkError: no router at the endpoint within `connect_timeout_s`.
    """
    try:
        return zenoh.open(_config(client_settings(link, name=name)))
    except zenoh.ZError as error:
        raise LinkError(
            f"no router answered at {link.router} within {link.connect_timeout_s:g} s ({_short(error)}); "
            "start one with `tuberline router`, or mend link.router in the config"
        ) from error


def open_router(link: LinkConfig) -> zenoh.Session:
    """A router session listening on the line's endpoints: the same Rust core as zenohd.

    Raises:
        LinkError: the endpoint is taken or cannot be bound.
    """
    endpoints = link.listen or (link.router,)
    try:
        return zenoh.open(_config(router_settings(link)))
    except zenoh.ZError as error:
        raise LinkError(
            f"cannot listen on {', '.join(endpoints)}: {_short(error)}; is a router running there?"
        ) from error


def client_settings(link: LinkConfig, *, name: str) -> dict[str, Any]:
    """Zenoh settings of a node; `name` shows up in the router's admin space."""
    return {
        "mode": "client",
        "connect": {
            "endpoints": [link.router],
            "timeout_ms": int(link.connect_timeout_s * 1000),
            "retry": {"period_init_ms": 50, "period_max_ms": 500, "period_increase_factor": 1.5},
        },
        "listen": {"endpoints": []},
        "metadata": {"name": name, "host": socket.gethostname()},
        **_common(link),
    }


def router_settings(link: LinkConfig) -> dict[str, Any]:
    """Zenoh settings of the line's router."""
    return {
        "mode": "router",
        "listen": {"endpoints": list(link.listen or (link.router,))},
        "adminspace": {"enabled": True},
        "metadata": {"name": "router", "host": socket.gethostname()},
        **_common(link),
    }


def _common(link: LinkConfig) -> dict[str, Any]:
    transport: dict[str, Any] = {
        "shared_memory": {"enabled": False},
        "link": {
            "tx": {"lease": link.lease_ms, "keep_alive": 4},
            "rx": {"buffer_size": 4 << 20, "max_message_size": 128 << 20},
        },
    }
    if link.root_ca or link.certificate or link.private_key:
        transport["link"]["tls"] = _tls(link)
    return {
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "timestamping": {"enabled": True},
        "transport": transport,
    }


def _tls(link: LinkConfig) -> dict[str, Any]:
    if not (link.root_ca and link.certificate and link.private_key):
        raise LinkError(
            "TLS needs all of link.root_ca, link.certificate and link.private_key; `tuberline certs` makes them"
        )
    for path in (link.root_ca, link.certificate, link.private_key):
        if not path.is_file():
            raise LinkError(f"TLS file {path} does not exist; `tuberline certs` makes one set per node")
    certificate, key = str(link.certificate), str(link.private_key)
    return {
        "root_ca_certificate": str(link.root_ca),
        "enable_mtls": True,
        "listen_certificate": certificate,
        "listen_private_key": key,
        "connect_certificate": certificate,
        "connect_private_key": key,
    }


def _config(settings: dict[str, Any]) -> zenoh.Config:
    return zenoh.Config.from_json5(json.dumps(settings))


def _short(error: Exception) -> str:
    """The first clause of Zenoh's error, without its source locations."""
    return str(error).split(" at ")[0].split(" - ")[0].strip()[:200]
