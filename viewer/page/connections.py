"""Connections of the page: bounded in number and in time, so that slow or silent sockets keep no one out.

uvicorn bounds headers and idle connections; what it lacks is here: a limit on all connections, a time limit on the
first request, and an end for a browser that takes no more bytes.
"""

from __future__ import annotations

import asyncio
import socket
from typing import Any, ClassVar

from uvicorn.protocols.http.h11_impl import H11Protocol

MAX_CONNECTIONS = 256
REQUEST_WITHIN_S = 5.0
"""A connection that has not sent its first request by then is closed."""
TAKE_WITHIN_MS = 10_000
"""The system closes a connection whose other side takes no byte for so long (Linux)."""


class BoundedConnection(H11Protocol):
    """One connection. At the limit a new one takes the place of the oldest that has not asked for anything yet."""

    by_peer: ClassVar[dict[Any, BoundedConnection]] = {}

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the connection, or close it where all places are in use."""
        self._refused = len(self.connections) >= MAX_CONNECTIONS and not self._make_room()
        if self._refused:
            transport.abort()  # type: ignore[attr-defined]
            return
        super().connection_made(transport)  # type: ignore[arg-type]
        self.by_peer[self.client] = self
        self._began_s = self.loop.time()
        self._deadline = self.loop.call_later(REQUEST_WITHIN_S, self.abort_if_silent)
        channel = transport.get_extra_info("socket")
        if channel is not None and hasattr(socket, "TCP_USER_TIMEOUT"):
            channel.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, TAKE_WITHIN_MS)

    def data_received(self, data: bytes) -> None:
        """Bytes of a request; those of a refused connection are not read."""
        if not self._refused:
            super().data_received(data)

    def connection_lost(self, exc: Exception | None) -> None:
        """The other side went, or was let go."""
        if self._refused:
            return
        self._deadline.cancel()
        self.by_peer.pop(self.client, None)
        super().connection_lost(exc)

    @property
    def silent(self) -> bool:
        """It has not sent a whole request yet."""
        return self.cycle is None

    def abort_if_silent(self) -> None:
        """Close it unless it asked for something."""
        if self.silent:
            self.transport.abort()

    def _make_room(self) -> bool:
        """Close the oldest connection that waits to ask; False where all of them are being answered."""
        silent = [other for other in self.connections if isinstance(other, BoundedConnection) and other.silent]
        if not silent:
            return False
        oldest = min(silent, key=lambda other: other._began_s)
        self.connections.discard(oldest)
        oldest.transport.abort()
        return True


def abort(peer: Any) -> None:
    """Drop the connection of `peer` with what still waits to be sent."""
    found = BoundedConnection.by_peer.get(tuple(peer) if peer else None)
    if found is not None:
        found.transport.abort()
