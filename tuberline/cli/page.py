"""`tuberline page`: the operator's page of one line or several."""

from __future__ import annotations

import logging
import signal
import threading
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from conveyor.errors import ConfigError
from tuberline.cli.address import LineAddress

TICK_S = 1.0


def page(
    *,
    config: Annotated[tuple[Path, ...], Parameter(negative_iterable="")] = (),
    connect: str | None = None,
    line: Annotated[tuple[str, ...], Parameter(negative_iterable="")] = (),
    listen: str = "127.0.0.1:9180",
) -> None:
    """Serve the operator's page: the load, the belt, cameras, alarms in plain words. Changes nothing of a line.

    Parameters
    ----------
    config
        A line's TOML file; given several times, the page shows several lines.
    connect
        Endpoint of a router, e.g. tcp/10.0.0.1:7447; instead of a config.
    line
        Names of the lines at that router, where no config says them.
    listen
        HOST:PORT to serve the page on. Beyond this machine only where everybody in the network may look; else put
        deploy/proxy before it.
    """
    from conveyor.access import known_nodes
    from conveyor.notify import notify
    from viewer.page.board import Board
    from viewer.page.server import PageServer
    from viewer.page.snapshot import snapshot
    from viewer.page.watch import LineWatch

    host, port = _address(listen)
    if config and (connect or line):
        raise ConfigError("give --config (once for each line), or --connect with --line, not both")
    addresses = (
        [LineAddress(path) for path in config]
        if config
        else [LineAddress(None, connect, name) for name in (line or (None,))]
    )
    names = [address.link()[1] for address in addresses]
    if len(set(names)) < len(names):
        raise ConfigError(f"two of the lines have the same name: {', '.join(names)}; give each its own")
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    board = Board(names)
    watches = [
        LineWatch(
            address.link()[0],
            line=name,
            tell=lambda look: board.put(snapshot(look)),
            known=known_nodes(address.loaded()) if address.config else (),
        )
        for address, name in zip(addresses, names, strict=True)
    ]
    with PageServer(board, host=host, port=port) as server:
        for watch in watches:
            watch.start()
        shown = f"[{host}]" if ":" in host else host
        logging.getLogger("page").info("%s at http://%s:%d/", ", ".join(names), shown, server.port)
        notify("READY=1")
        while not stop.wait(TICK_S):
            if not server.serves:
                raise RuntimeError("the page's server has ended")
            notify("WATCHDOG=1")
        for watch in watches:
            watch.stop()


def _address(listen: str) -> tuple[str, int]:
    host, _, port = listen.rpartition(":")
    if not host or not port.isdigit() or int(port) > 65535:
        raise ConfigError(f"--listen {listen} is not HOST:PORT, e.g. 127.0.0.1:9180")
    return host.strip("[]"), int(port)
