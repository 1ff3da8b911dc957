"""Alarms, messages and a receiver over HTTP for the alarms' tests."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from tuberline.alarms.machine import Seen
from tuberline.alarms.message import AlarmMessage


def seen(key: str, **changes: str) -> Seen:
    """Something wrong."""
    return Seen(**{"key": key, "level": "trouble", "text": f"{key} is wrong.", "fix": "Repair it.", **changes})


def message(n: int, *, event: str = "begin") -> AlarmMessage:
    """Message `n` of an outbox 'box'."""
    ended = 1_800_000_100.0 if event == "end" else None
    name = f"box-{n}"
    text, fix = f"Alarm {n}.", "Repair it."
    return AlarmMessage(
        f"{name}-{event}", name, event, "north", "", f"k{n}", "trouble", text, fix, 1_800_000_000, ended
    )


class Receiver:
    """A real HTTP server that keeps what it takes; `answer` is the status it gives."""

    def __init__(self, port: int = 0) -> None:
        self.taken: list[dict[str, Any]] = []
        self.asked: list[dict[str, str]] = []
        self.paths: list[str] = []
        self.answer = 204
        receiver = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                receiver.asked.append(dict(self.headers.items()))
                receiver.paths.append(self.path)
                if receiver.answer < 300:
                    receiver.taken.append(json.loads(body))
                self.send_response(receiver.answer)
                if 300 <= receiver.answer < 400:
                    self.send_header("Location", "/elsewhere")
                self.end_headers()

            def log_message(self, *_: object) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
        self.port = int(self._server.server_address[1])
        self.url = f"http://127.0.0.1:{self.port}/alarms"
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Listen no more."""
        self._server.shutdown()
        self._server.server_close()


@contextmanager
def receiving(port: int = 0) -> Iterator[Receiver]:
    """A receiver for a while."""
    receiver = Receiver(port)
    try:
        yield receiver
    finally:
        receiver.close()
