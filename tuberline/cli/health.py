"""`tuberline health`: is the router, or one node, well? For probes."""

from __future__ import annotations

import json as json_module
import sys
import time
from typing import Annotated

from conveyor.errors import LinkError
from conveyor.messages import Counters
from conveyor.observer import Observer
from tuberline.cli.address import NO_ADDRESS, LineAddress
from tuberline.cli.numbers import within


def health(
    *,
    address: LineAddress = NO_ADDRESS,
    node: str | None = None,
    timeout_s: Annotated[float, within(0.1, 3600, "s")] = 5.0,
    json: bool = False,
) -> None:
    """Say whether the router answers and, if named, one node is alive and makes progress; 75 (try again) if not.

    Parameters
    ----------
    node
        ROLE/NAME, e.g. camera/front.
    timeout_s
        How long to look for it.
    json
        Print the answer as JSON on stdout: router, line, well, why, and of a node its status, uptime_s and pid.
    """
    link, line = address.link()
    report: dict[str, object] = {"router": link.router, "line": line, "node": node, "well": False, "why": ""}
    try:
        with Observer(link.model_copy(update={"connect_timeout_s": timeout_s}), line=line) as observer:
            counters = _reported(observer, node, line, timeout_s=timeout_s) if node else None
        if counters:
            report |= {"status": counters.status, "uptime_s": counters.uptime_s, "pid": counters.pid}
            if counters.status != "ok":
                raise LinkError(f"{node} is {counters.status} after {counters.uptime_s:.0f} s (pid {counters.pid})")
    except LinkError as error:
        if not json:
            raise
        sys.stdout.write(json_module.dumps(report | {"why": str(error)}, indent=2) + "\n")
        sys.exit(error.exit_code)
    if json:
        sys.stdout.write(json_module.dumps(report | {"well": True}, indent=2) + "\n")
    elif counters:
        sys.stdout.write(f"{node} is well: up {counters.uptime_s:.0f} s\n")
    else:
        sys.stdout.write(f"router at {link.router} answers\n")


def _reported(observer: Observer, node: str, line: str, *, timeout_s: float) -> Counters:
    """What `node` reported last, once it is alive.

    Raises:
        LinkError: it is not there in time.
    """
    deadline = time.monotonic() + timeout_s
    while not (node in observer.alive() and node in observer.nodes()):
        if time.monotonic() > deadline:
            known = ", ".join(sorted(observer.alive())) or "none"
            raise LinkError(f"{node} of line '{line}' is not alive; alive: {known}")
        time.sleep(0.05)
    return observer.nodes()[node]
