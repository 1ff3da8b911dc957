"""The page's web server: a handful of files and one stream of events. Reads only, few clients, nobody waits for them.

The standard library's server with what it lacks: a bound on connections, time limits on every read and write, no names
but this machine's own (a page elsewhere must not reach it through a browser by a trick of DNS), and strict headers.
"""

from __future__ import annotations

import ipaddress
import logging
import socket
import threading
from collections.abc import Callable, Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from conveyor import __version__
from conveyor.errors import LinkError
from viewer.page.board import Board
from viewer.page.files import File, read_files

MAX_CONNECTIONS = 48
MAX_STREAMS = 32
"""Browsers that look at the same time. A stream is a thread that sleeps and some kilobytes a second."""
REQUEST_WITHIN_S = 5.0
SEND_WITHIN_S = 5.0
"""A frozen browser's connection is closed after this; when it wakes up it asks again."""
BEAT_S = 2.0
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
        "manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
    "Connection": "close",
}
LOCAL_NAMES = frozenset({"localhost", socket.gethostname().lower(), f"{socket.gethostname().lower()}.local"})


class PageServer:
    """Serves the page and the board's snapshots on its own threads. Use as a context manager."""

    def __init__(self, board: Board, *, host: str, port: int) -> None:
        self.streams = threading.BoundedSemaphore(MAX_STREAMS)
        self.stopping = threading.Event()
        try:
            self._server = _Server((host, port), _handler(self, board, read_files()))
        except OSError as error:
            raise LinkError(
                f"cannot serve the page on {host}:{port}: {error.strerror or error}; give another --listen HOST:PORT"
            ) from error
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.2,), name="page-server", daemon=True)

    @property
    def port(self) -> int:
        """The port it listens on."""
        return int(self._server.server_address[1])

    def __enter__(self) -> PageServer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stopping.set()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join(2.0)


class _Server(ThreadingHTTPServer):
    """One thread a connection, at most `MAX_CONNECTIONS` of them; the next one is closed at once."""

    daemon_threads = True
    block_on_close = False
    request_queue_size = 16

    def __init__(self, address: tuple[str, int], handler: type[BaseHTTPRequestHandler]) -> None:
        self.address_family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
        self._free = threading.BoundedSemaphore(MAX_CONNECTIONS)
        super().__init__(address, handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        if not self._free.acquire(blocking=False):
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        logging.getLogger("page").debug("connection of %s ended badly", client_address, exc_info=True)


def _handler(page: PageServer, board: Board, files: Mapping[str, File]) -> type[BaseHTTPRequestHandler]:
    """The class of a connection's handler, bound to this server's board and files."""

    class Handler(BaseHTTPRequestHandler):
        server_version = f"tuberline/{__version__}"
        sys_version = ""
        protocol_version = "HTTP/1.1"
        timeout = REQUEST_WITHIN_S

        def do_GET(self) -> None:
            self._answer(body=True)

        def do_HEAD(self) -> None:
            self._answer(body=False)

        def _answer(self, *, body: bool) -> None:
            self.close_connection = True
            path = self.path.partition("?")[0]
            if not own_name(self.headers.get("Host", "")):
                self.send_error(HTTPStatus.MISDIRECTED_REQUEST, "Ask by address, or by this machine's own name")
            elif path == "/events" and body:
                self._stream()
            elif path == "/snapshot.json":
                self._send(File("application/json", board.newer(-1, 0.0)[1].encode()), body=body)
            elif path in files:
                self._send(files[path], body=body)
            else:
                self.send_error(HTTPStatus.NOT_FOUND)

        def _send(self, file: File, *, body: bool) -> None:
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", file.kind)
            self.send_header("Content-Length", str(len(file.content)))
            self.end_headers()
            if body:
                self.wfile.write(file.content)

        def _stream(self) -> None:
            if not page.streams.acquire(blocking=False):
                self.send_error(HTTPStatus.SERVICE_UNAVAILABLE, f"{MAX_STREAMS} browsers look already")
                return
            try:
                self.send_response(HTTPStatus.OK)
                self.send_header("Content-Type", "text/event-stream; charset=utf-8")
                self.send_header("X-Accel-Buffering", "no")
                self.end_headers()
                self.connection.settimeout(SEND_WITHIN_S)
                _events(self.wfile.write, board, page.stopping)
            except OSError:
                return  # the browser is gone, or frozen
            finally:
                page.streams.release()

        def end_headers(self) -> None:
            for name, value in HEADERS.items():
                self.send_header(name, value)
            super().end_headers()

        def log_message(self, *args: Any) -> None:
            """Requests are not logged: a page that is looked at all day would fill the journal."""

    return Handler


def _events(write: Callable[[bytes], Any], board: Board, stopping: threading.Event) -> None:
    """The board as server-sent events until told to stop; raises OSError when nobody takes them any more."""
    write(b"retry: 1000\n\n")
    version = -1
    while not stopping.is_set():
        # Also without anything new: the browser hears that this server lives, and its end is noticed here.
        version, text = board.newer(version, BEAT_S)
        write(f"data: {text}\n\n".encode())


def own_name(host: str) -> bool:
    """The name a browser asked for is an address or this machine's own name, with any port or none."""
    name = host.rpartition(":")[0] if host.rpartition(":")[2].isdigit() and not host.endswith("]") else host
    name = name.strip("[]").lower()
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return name in LOCAL_NAMES
    return True
