"""Foxglove's app, live: its WebSocket server in this process. Messages are made only for who subscribes to them."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from conveyor.counters import CounterSet
from conveyor.errors import LinkError
from conveyor.served import ServedAt
from viewer.foxglove.pen import SCENE, TRANSFORMS, Pen, encoded, schema_of
from viewer.foxglove.sdk import ServerListener, foxglove
from viewer.scene.primitives import Entry
from viewer.sink import IDLE_S, Sink

TELL_AGAIN = 2
"""The server says that someone subscribes a moment before it sends to them: the scene is told in two ticks."""
BACKLOG = 48
"""Messages that wait for a slow app, each; the oldest give way. With pictures of 0.8 MB a third of them: 13 MB."""


def address_of(text: str) -> ServedAt:
    """Where Foxglove's app connects to.

    Raises:
        ConfigError: it is not HOST:PORT.
    """
    return ServedAt.parse(text, option="foxglove", example="127.0.0.1:8765")


class _Listener(ServerListener):
    """Hears from the server's own threads that someone subscribed."""

    def __init__(self, came: Callable[[], None]) -> None:
        self._came = came

    def on_subscribe(self, client: Any, channel: Any) -> None:
        """Someone opened a panel."""
        self._came()

    def on_unsubscribe(self, client: Any, channel: Any) -> None:
        """Someone closed one."""


class ServerOutlet:
    """Channels of one server; without a subscriber nothing is encoded."""

    def __init__(self, context: Any) -> None:
        self._context = context
        self._channels: dict[str, Any] = {}
        self._kinds: dict[str, str] = {}

    def wants(self, topic: str, kind: str) -> bool:
        """Somebody subscribes to the topic."""
        if topic not in self._channels:
            encoding, name, schema_encoding, data = schema_of(kind)
            schema = foxglove.Schema(name=name, encoding=schema_encoding, data=data)
            self._channels[topic] = self._context._create_channel(topic, message_encoding=encoding, schema=schema)
            self._kinds[topic] = kind
        return bool(self._channels[topic].has_sinks())

    def put(self, topic: str, message: Any, captured_ns: int) -> None:
        """Hand a message to the server, which never waits for an app."""
        self._channels[topic].log(encoded(self._kinds[topic], message), log_time=captured_ns)


class ServerSink(Sink):
    """See the module."""

    def __init__(
        self, address: ServedAt, *, run: str, tick_s: float, counters: CounterSet, log: logging.Logger
    ) -> None:
        super().__init__("foxglove", run=run, tick_s=tick_s, counters=counters, log=log)
        self._came = threading.Event()
        self._tell_again = 0
        self._listener = _Listener(self._someone_came)
        self._context = foxglove.Context()
        outlet = ServerOutlet(self._context)
        # Told to an app as it connects: one that subscribes the moment a channel is told later may come too soon for
        # the server ("unknown channel"), and has none of it until it connects again.
        outlet.wants(TRANSFORMS, "FrameTransform")
        outlet.wants(SCENE, "SceneUpdate")
        self._pen = Pen(outlet)
        foxglove.set_log_level("WARNING")
        try:
            self._server = foxglove.start_server(
                name=f"tuberline {run}",
                host=address.host,
                port=address.port,
                capabilities=[],
                server_listener=self._listener,
                context=self._context,
                message_backlog_size=BACKLOG,
            )
        except (RuntimeError, OSError) as error:
            raise LinkError(
                f"Foxglove's server cannot listen at {address} ({error}): another program has the "
                "port, or the address is not of this machine; give another with --foxglove HOST:PORT"
            ) from error
        self.address = replace(address, port=self._server.port)
        counters.add("foxglove_subscribed", 0)
        counters.gauge("foxglove_port", self._server.port)
        log.info("Foxglove: open ws://%s", self.address)

    def _someone_came(self) -> None:
        """The scene is told once more, and at once."""
        self._counters.add("foxglove_subscribed")
        self._came.set()
        self._outbox.wake()

    def _work(self) -> None:
        while not self._stop.is_set():
            self._send(self._outbox.take(0.0 if self._tell_again else IDLE_S))
            self._stop.wait(self._tick_s)
        self._send(self._outbox.take(0.0))
        self._server.stop()

    def _send(self, batch: list[Entry]) -> None:
        if self._came.is_set():
            self._came.clear()
            self._tell_again = TELL_AGAIN
        if self._tell_again:
            self._tell_again -= 1
            self._pen.again()
        self._under_way = len(batch)
        for entry in batch:
            self._draw(entry)
        self._counters.add("foxglove_sent", len(batch))
        self._counters.add("logged", len(batch))
        self._under_way = 0

    def _put(self, entry: Entry) -> None:
        self._pen.draw(entry)

    def _switch_run(self, run: str) -> None:
        self._pen.forget()
        self._server.clear_session(run)
