"""Who listens on a port already: two lines at one router would mix their loads.

A port counts as taken only while somebody takes connections there: what a dead process left behind goes away by itself,
and is waited for. No message is read here: a router starts a third sooner without numpy.
"""

from __future__ import annotations

import contextlib
import json
import random
import socket
import time
from collections.abc import Callable

import zenoh

from conveyor.config import LinkConfig
from conveyor.endpoints import host_and_port, takes_connections
from conveyor.errors import TakenError, TuberlineError
from conveyor.lines import nodes_of_lines
from conveyor.session import open_client

ASK_S = 2.0
PORT_IS_LEFT_WITHIN_S = 3.0
"""A line that was stopped or killed a moment ago lets go of its port by then."""
LOOK_EVERY_S = 0.1
CONNECT_S = 0.5
NOT_GIVEN_OUT, PORTS_TRIED = range(20_000, 32_768), 100
"""Linux gives connections ports from 32768 on, other systems from 49152."""


def check_port_free(link: LinkConfig, *, stop: Callable[[], bool] = lambda: False) -> None:
    """Return when no one listens where this line's router is to listen.

    Raises:
        TakenError: somebody does, and stays; says who.
    """
    deadline = time.monotonic() + PORT_IS_LEFT_WITHIN_S
    while (endpoint := _listened_to(link)) is not None and not stop():
        if time.monotonic() > deadline:
            raise TakenError(
                f"cannot listen on {endpoint}: {who_routes(link, endpoint)}. Stop it, choose another port in "
                "link.router, or use --no-router to join that router with this line's nodes"
            )
        time.sleep(LOOK_EVERY_S)


def who_routes(link: LinkConfig, endpoint: str) -> str:
    """Who listens at `endpoint`, in words: a router with its host and the nodes that live at it, or something else."""
    there = link.model_copy(update={"router": endpoint, "connect_timeout_s": ASK_S})
    try:
        with open_client(there, name="router") as session:
            routers = [reply.ok for reply in session.get("@/*/router", timeout=ASK_S) if reply.ok is not None]
            lines = nodes_of_lines(session)
            host = json.loads(routers[0].payload.to_string())["metadata"]["host"] if routers else "an unknown host"
    except (TuberlineError, zenoh.ZError, ValueError, KeyError, TypeError):
        return "another program listens there"
    nodes = sorted(f"{line}: {node}" for line, there in lines.items() for node in there)
    return f"a router on {host} listens there, with {', '.join(nodes) or 'no nodes'}"


def _listened_to(link: LinkConfig) -> str | None:
    """The first of the router's own endpoints at which somebody accepts connections, as a client reaches it."""
    for endpoint in link.listen or (link.router,):
        protocol, (host, port) = endpoint.partition("/")[0], host_and_port(endpoint)
        if protocol not in ("tcp", "tls", "ws") or not port.isdecimal():
            continue
        host = {"0.0.0.0": "127.0.0.1", "[::]": "::1", "*": "127.0.0.1"}.get(host, host).strip("[]")
        if takes_connections(host, int(port), within_s=CONNECT_S):
            return f"{protocol}/{f'[{host}]' if ':' in host else host}:{port}"
    return None


def free_port() -> int:
    """A TCP port of this machine that was free a moment ago.

    None of those that the system gives to connections that go out: it might give this one to another program's before
    a router listens there.
    """
    for port in random.SystemRandom().sample(NOT_GIVEN_OUT, PORTS_TRIED):
        with contextlib.suppress(OSError), socket.socket() as probe:
            probe.bind(("127.0.0.1", port))
            return port
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
