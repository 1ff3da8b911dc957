"""`tuberline metrics`: a Prometheus exporter of one line."""

from __future__ import annotations

import logging
import threading
from dataclasses import replace

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
    from conveyor.served import ServedAt
    from conveyor.signals import stop_when_told
    from tuberline.metrics import serving

    at = ServedAt.parse(listen, option="--listen", example="127.0.0.1:9108")
    link, name = address.link()
    stop = threading.Event()
    stop_when_told(stop)
    with Observer(link, line=name) as observer, serving(observer, at) as port:
        logging.getLogger("metrics").info("line %s at http://%s/metrics", name, replace(at, port=port))
        notify("READY=1")
        while not stop.wait(1.0):
            notify("WATCHDOG=1")
