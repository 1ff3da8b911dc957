"""The router of a line."""

from __future__ import annotations

import logging
import threading
import time
from pathlib import Path

from conveyor.access import router_access
from conveyor.config import LineConfig, load_config
from conveyor.heap import GIVE_BACK_EVERY_S, give_back
from conveyor.notify import notify
from conveyor.session import open_router
from conveyor.signals import stop_when_told
from conveyor.taken_port import check_port_free
from tuberline.cli.address import endpoint


def router(*, config: Path | None = None, listen: str | None = None) -> None:
    """Route a line's messages until stopped.

    Parameters
    ----------
    config
        The line's TOML file; its link section is used, and its access section where that is enabled.
    listen
        Endpoint to listen on, e.g. tcp/0.0.0.0:7447; instead of a config.

    Raises
    ------
    TakenError
        Somebody listens there already; the text says who.
    """
    line = load_config(config) if config else LineConfig()
    link = line.link
    if listen:
        link = link.model_copy(update={"listen": (endpoint(listen),)})
    stop = threading.Event()
    stop_when_told(stop)
    check_port_free(link, stop=stop.is_set)
    with open_router(link, access_control=router_access(line)):
        logging.getLogger("router").info("listening on %s", ", ".join(link.listen or (link.router,)))
        notify("READY=1")
        given_back = time.monotonic()
        while not stop.wait(1.0):
            notify("WATCHDOG=1")
            if time.monotonic() - given_back >= GIVE_BACK_EVERY_S:
                given_back = time.monotonic()
                give_back()
