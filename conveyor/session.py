"""The Zenoh session: every process is a client of a router; explicit endpoints, no multicast, no shared memory.

Star topology because since Zenoh 1.9 peers never relay for each other; shared memory off because receivers leak locked
memory when a publisher restarts and lose frames silently under container limits (both measured, docs/design.md).
"""

from __future__ import annotations

import errno
import json
import logging
import queue
import socket
import threading
import time
from pathlib import Path
from typing import Any

import zenoh

from conveyor.config import LinkConfig
from conveyor.endpoints import host_and_port, takes_connections
from conveyor.errors import ConfigError, LinkError
from conveyor.identity import own_files
from conveyor.notify import still_starting
from conveyor.topics import TRANSMIT_BATCHES

TlsFiles = tuple[Path, Path, Path]
"""Authority, certificate, key."""
WAIT_FOR_EVER_MS = -1
SAY_FIRST_S, SAY_EVERY_S = 5.0, 60.0
LISTENS_WITHIN_S = 1.0
STARTING_FOR_S = 60.0
"""How much longer each look for the router lets a start take: a manager that hears nothing for so long may end it."""
ENCRYPTED = ("tls/", "quic/")
"""Endpoints that prove who is at the other end."""


def open_client(link: LinkConfig, *, name: str) -> zenoh.Session:
    """A client session to the line's router; close it (`with`) or the interpreter hangs at exit.

    Raises:
        LinkError: no router at the endpoint within `connect_timeout_s`.
    """
    try:
        return zenoh.open(_config(client_settings(link, name=name)))
    except zenoh.ZError as error:
        reason = short_reason(error)
        why = "" if reason.startswith("Unable to connect") else f" ({reason})"  # that much is said already
        raise LinkError(
            f"no router answered at {link.router} within {link.connect_timeout_s:g} s{why}; "
            "start the line with `tuberline run`, or a router alone with `tuberline router`, or correct its address "
            "(link.router in the config, --connect)"
        ) from error


def join_router(link: LinkConfig, *, name: str, stop: threading.Event, log: logging.Logger) -> zenoh.Session | None:
    """A client session as soon as the line's router is there, however long that takes; None once `stop` is set.

    Hosts of a line boot in any order: a router that is still to come is no failure, and is said once a minute.

    Raises:
        ConfigError: certificates that are missing or contradict the endpoint.
        LinkError: Zenoh refuses for another reason than a router that is away.
    """
    settings = _config(client_settings(link, name=name, timeout_ms=WAIT_FOR_EVER_MS))
    opened: queue.SimpleQueue[zenoh.Session | zenoh.ZError] = queue.SimpleQueue()

    def connect() -> None:
        try:
            opened.put(zenoh.open(settings))
        except zenoh.ZError as error:
            opened.put(error)

    threading.Thread(target=connect, name="connect", daemon=True).start()
    began_s, say_s = time.monotonic(), SAY_FIRST_S
    while not stop.is_set():
        try:
            answer = opened.get(timeout=0.2)
        except queue.Empty:
            waited_s = time.monotonic() - began_s
            still_starting(STARTING_FOR_S)
            if waited_s >= say_s:
                why = _LISTENS if _listened_to(link.router) else ""
                log.warning("no router answers at %s for %.0f s: waiting for it%s", link.router, waited_s, why)
                say_s += SAY_EVERY_S
            continue
        if isinstance(answer, zenoh.Session):
            return answer
        raise LinkError(f"cannot join the router at {link.router}: {short_reason(answer)}") from answer
    return None


_LISTENS = (
    "; something listens there: a router that hangs, has certificates of another authority, or speaks tls/ where "
    "link.router says tcp/, or the other way round; `tuberline doctor` tells more"
)


def _listened_to(endpoint: str) -> bool:
    """Whether a port takes connections there, of a router or of another program."""
    host, port = host_and_port(endpoint)
    return endpoint.startswith(("tcp/", "tls/")) and takes_connections(host, int(port), within_s=LISTENS_WITHIN_S)


def open_router(link: LinkConfig, *, access_control: dict[str, Any] | None = None) -> zenoh.Session:
    """A router session listening on the line's endpoints: the same Rust core as zenohd.

    Args:
        link: where to listen, and its certificate.
        access_control: rules as `conveyor.access.access_control` makes them; None lets everybody do everything.

    Raises:
        LinkError: the endpoint is taken or cannot be bound.
    """
    endpoints = link.listen or (link.router,)
    try:
        return zenoh.open(_config(router_settings(link, access_control=access_control)))
    except zenoh.ZError as error:
        away = f"os error {errno.EADDRNOTAVAIL})" in str(error)
        hint = "this machine has no such address now" if away else "is a router running there?"
        raise LinkError(f"cannot listen on {', '.join(endpoints)}: {short_reason(error)}; {hint}") from error


def client_settings(link: LinkConfig, *, name: str, timeout_ms: int | None = None) -> dict[str, Any]:
    """Zenoh settings of a node; `name` shows up in the router's admin space. `timeout_ms` -1 waits forever."""
    return {
        "mode": "client",
        "connect": {
            "endpoints": [link.router],
            "timeout_ms": int(link.connect_timeout_s * 1000) if timeout_ms is None else timeout_ms,
            "retry": {"period_init_ms": 50, "period_max_ms": 500, "period_increase_factor": 1.5},
        },
        "listen": {"endpoints": []},
        "metadata": {"name": name, "host": socket.gethostname()},
        **common_settings(link, _tls_files(link, name)),
    }


def router_settings(
    link: LinkConfig, *, access_control: dict[str, Any] | None = None, files: TlsFiles | None = None
) -> dict[str, Any]:
    """Zenoh settings of the line's router.

    Args:
        link: where to listen.
        access_control: rules as `conveyor.access` makes them.
        files: where the router's certificates will be, unchecked; default: those of `link`, which must exist.
    """
    return {
        "mode": "router",
        "listen": {"endpoints": list(link.listen or (link.router,))},
        "adminspace": {"enabled": True},
        "metadata": {"name": "router", "host": socket.gethostname()},
        **({"access_control": access_control} if access_control else {}),
        **common_settings(link, files or _tls_files(link, "router")),
    }


def common_settings(link: LinkConfig, files: TlsFiles | None = None) -> dict[str, Any]:
    """What holds at both ends of every link."""
    transport: dict[str, Any] = {
        "shared_memory": {"enabled": False},
        "link": {
            "tx": {
                "lease": link.lease_ms,
                "keep_alive": 4,
                "queue": {"size": {priority.value: batches for priority, batches in TRANSMIT_BATCHES.items()}},
            },
            "rx": {"buffer_size": 4 << 20, "max_message_size": 128 << 20},
        },
    }
    if files:
        transport["link"]["tls"] = _tls(files)
    return {
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "timestamping": {"enabled": True},
        "transport": transport,
    }


def _has_certificates(link: LinkConfig) -> bool:
    return bool(link.certs or link.root_ca or link.certificate or link.private_key)


def link_fault(link: LinkConfig) -> str:
    """What of [link] contradicts itself, whatever files are here; empty where nothing does."""
    endpoints = (link.router, *link.listen)
    encrypted = any(endpoint.startswith(ENCRYPTED) for endpoint in endpoints)
    if encrypted and not _has_certificates(link):
        return f"link uses {', '.join(endpoints)}: set link.certs (`tuberline certs make` fills a folder)"
    if _has_certificates(link) and not encrypted:
        return f"link has certificates but link.router is {link.router}, not encrypted: make it tls/HOST:PORT"
    return ""


def _tls_files(link: LinkConfig, name: str) -> TlsFiles | None:
    """The certificates of the process `name`; None where the link is plain."""
    if fault := link_fault(link):
        raise ConfigError(fault)
    if not _has_certificates(link):
        return None
    files = own_files(link.certs, name) if link.certs else (link.root_ca, link.certificate, link.private_key)
    root_ca, certificate, key = files
    if not (root_ca and certificate and key):
        raise ConfigError(
            "TLS needs link.certs, or all of link.root_ca, link.certificate and link.private_key; "
            "`tuberline certs` makes them"
        )
    for path in (root_ca, certificate, key):
        if not path.is_file():
            raise ConfigError(f"TLS file {path} does not exist; `tuberline certs` makes one set per node")
    return root_ca, certificate, key


def _tls(files: TlsFiles) -> dict[str, Any]:
    root_ca, certificate, key = (str(path) for path in files)
    return {
        "root_ca_certificate": root_ca,
        "enable_mtls": True,
        "listen_certificate": certificate,
        "listen_private_key": key,
        "connect_certificate": certificate,
        "connect_private_key": key,
    }


def _config(settings: dict[str, Any]) -> zenoh.Config:
    return zenoh.Config.from_json5(json.dumps(settings))


def refusal_of(error: zenoh.ReplyError) -> str:
    """Why a question was refused, in the words of who refused it; what is no UTF-8 of it is replaced."""
    return error.payload.to_bytes().decode(errors="replace")


def short_reason(error: Exception) -> str:
    """The first clause of Zenoh's error, without its source locations."""
    return str(error).split(" at ")[0].split(" - ")[0].strip()[:200]
