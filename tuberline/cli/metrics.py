"""`tuberline metrics`: a Prometheus exporter of one line."""

from __future__ import annotations

import logging
import signal
import threading

from conveyor.errors import ConfigError
from tuberline.cli.address import NO_ADDRESS, LineAddress


def metrics(*, address: LineAddress = NO_ADDRESS, listen: str = "127.0.0.1:9108") -> None:
    """Serve a line's counters, levels and totals to Prometheus until stopped.

    Parameters
    ----------
    listen
        HOST:PORT to serve /metrics on; 127.0.0.1 unless Prometheus runs elsewhere.
    """
    from conveyor.notify import notify
    from conveyor.observer import Observer
    from tuberline.metrics import serving

    host, _, port = listen.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise ConfigError(f"--listen {listen} is not HOST:PORT, e.g. 127.0.0.1:9108")
    link, name = address.link()
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    with Observer(link, line=name) as observer, serving(observer, host=host.strip("[]"), port=int(port)):
        logging.getLogger("metrics").info("line %s at http://%s/metrics", name, listen)
        notify("READY=1")
        while not stop.wait(1.0):
            notify("WATCHDOG=1")
