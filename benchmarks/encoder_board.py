"""An encoder's board as a harvester has it: it sends its count over TCP, to all who listen, whatever happens to it."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from types import TracebackType
from typing import Self

import numpy as np

METRES_PER_PULSE = 0.0005
SENDS_EVERY_S = 0.02
FULL = 1 << 32


class EncoderBoard:
    """Counts the pulses of a recording's belt. `told` is its travel, metres, by capture time; what it says of
    `began_ns` passes at `starts_s` (time of the day), the rest at `speed`.
    """

    def __init__(self, told: Sequence[tuple[int, float]], *, began_ns: int, starts_s: float, speed: float) -> None:
        self._at_s = starts_s + np.array([t - began_ns for t, _ in told]) / 1e9 / speed
        self._travel_m = np.array([travel_m for _, travel_m in told])
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._server.getsockname()[1])
        self.mute = False
        self._base = FULL - 400
        """It is full, and goes on at 0, when the belt has run a fifth of a metre."""

    def __enter__(self) -> Self:
        threading.Thread(target=self._serve, daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.close()

    @property
    def ends_s(self) -> float:
        """When the belt's last frame is due."""
        return float(self._at_s[-1])

    @property
    def done(self) -> float:
        """The share of the belt that has passed."""
        return float(np.interp(time.time(), self._at_s, np.linspace(0, 1, len(self._at_s)), left=0.0, right=1.0))

    def lose_count(self) -> None:
        """Its power failed for a moment."""
        self._base -= self._count()

    def _count(self) -> int:
        return self._base + round(float(np.interp(time.time(), self._at_s, self._travel_m)) / METRES_PER_PULSE)

    def _serve(self) -> None:
        with suppress(OSError):  # the test is over
            while True:
                peer, _ = self._server.accept()
                threading.Thread(target=self._send, args=(peer,), daemon=True).start()

    def _send(self, peer: socket.socket) -> None:
        with suppress(OSError), peer:
            while True:
                if not self.mute:
                    peer.sendall(b"%d\r\n" % (self._count() % FULL))
                time.sleep(SENDS_EVERY_S)
