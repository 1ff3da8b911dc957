"""A live hub or viewer: looked for, lost and found again, and no one waits for it."""

from __future__ import annotations

import logging
import socket
from urllib.parse import urlsplit

from conveyor.counters import CounterSet
from conveyor.errors import ConfigError
from viewer.rerun.sink import RerunSink
from viewer.sink import IDLE_S

PROBE_S = 0.5
RETRY_S = 1.0
FLUSH_S = 0.4
DEFAULT_HUB_PORT = 9876


class HubSink(RerunSink):
    """See the module. `url` is rerun+http://HOST:PORT/proxy."""

    def __init__(self, url: str, *, run: str, tick_s: float, counters: CounterSet, log: logging.Logger) -> None:
        super().__init__("hub", run=run, tick_s=tick_s, counters=counters, log=log)
        self._url = url
        self._address = hub_address(url)
        self._hung = False
        counters.add("hub_connects", 0)
        counters.add("hub_stalls", 0)
        counters.gauge("hub_connected", 0)

    def join(self, timeout_s: float) -> bool:
        """See `Sink`; a hub that took nothing at the end counts as hanging, for its stream would block at exit."""
        return super().join(timeout_s) and not self._hung

    def _work(self) -> None:
        while not self._stop.is_set():
            if self._reachable():
                self._connect()
                self._pump()
                self._counters.gauge("hub_connected", 0)
            self._stop.wait(RETRY_S)

    def _reachable(self) -> bool:
        """Probe first: connecting to nothing blocks Rerun for 5 s, and then it queues 200 MB."""
        try:
            socket.create_connection(self._address, PROBE_S).close()
        except OSError:
            return False
        return True

    def _connect(self) -> None:
        if self._stream is None:
            self._new_stream()
        self._stream.connect_grpc(self._url)
        self._counters.add("hub_connects")
        self._counters.gauge("hub_connected", 1)
        self._log.info("connected to %s", self._url)
        for entry in list(self._statics.values()):  # a hub that was restarted has forgotten what always holds
            self._draw(entry)

    def _pump(self) -> None:
        """Send batch after batch until the link breaks or the node stops."""
        while True:
            last = self._stop.is_set()
            batch = self._outbox.take(0.0 if last else IDLE_S)
            self._under_way = len(batch)
            for entry in batch:
                self._draw(entry)
            flushed = self._flushed()
            self._counters.add("hub_sent" if flushed else "hub_dropped_link", len(batch))
            self._counters.add("logged", len(batch) if flushed else 0)
            self._under_way = 0
            if not flushed:
                return
            if last:
                self._stream.disconnect()
                return
            self._stop.wait(self._tick_s)

    def _flushed(self) -> bool:
        """Wait, for as long as it takes, until the batch has left this process; False: link broken, or told to stop."""
        stalled = False
        while True:
            try:
                self._stream.flush(timeout_sec=FLUSH_S)
                return True
            except RuntimeError as error:
                if "severed" in str(error):
                    self._log.warning("%s is gone; looking for it every %.0f s", self._url, RETRY_S)
                    return False
            if self._stop.is_set():
                self._hung = True
                return False
            if not stalled:
                stalled = True
                self._counters.add("hub_stalls")
                self._log.warning("%s takes nothing; pictures are left out until it does", self._url)

    def _switch_run(self, run: str) -> None:
        self._run_id = run
        old = self._stream
        self._new_stream()
        self._stream.connect_grpc(self._url)
        old.disconnect()


def hub_address(url: str) -> tuple[str, int]:
    """Host and port of a hub's URL.

    Raises:
        ConfigError: not a URL that Rerun's hubs have.
    """
    parts = urlsplit(url)
    try:
        port = parts.port
    except ValueError:
        port = -1
    if (
        port == -1
        or parts.scheme not in ("rerun+http", "rerun+https")
        or not parts.hostname
        or parts.path.rstrip("/") != "/proxy"
    ):
        raise ConfigError(
            f"viewer hub '{url}' is not the URL of one: give rerun+http://HOST:{DEFAULT_HUB_PORT}/proxy "
            "(rerun+https behind TLS)"
        )
    return parts.hostname, port or (443 if parts.scheme == "rerun+https" else DEFAULT_HUB_PORT)
