"""The page's web server: uvicorn on a thread of its own, bounded in connections, headers and time."""

from __future__ import annotations

import asyncio
import logging
import socket
import threading
import time

import uvicorn

from conveyor.errors import LinkError
from viewer.page.acting import Acting
from viewer.page.app import page_app
from viewer.page.board import Board
from viewer.page.connections import BoundedConnection
from viewer.page.files import read_files
from viewer.page.maps import FieldMaps
from viewer.page.pictures import Pictures
from viewer.page.streams import PictureStreams, Streams
from viewer.page.watch import STILL_AFTER_S

KEEP_ALIVE_S = 5
MAX_HEADER_BYTES = 16 * 1024
BACKLOG = 64
STOP_WITHIN_S = 2


class PageServer:
    """Serves the page and the board's snapshots on its own thread. Use as a context manager.

    Args:
        acting: takes orders; None: the page only looks.
        pictures, maps: of the cameras and the field, where some are heard; None: there are none.

    Raises:
        LinkError: the port is taken, or the address is not this machine's.
    """

    def __init__(
        self,
        board: Board,
        *,
        host: str,
        port: int,
        acting: Acting | None = None,
        pictures: Pictures | None = None,
        maps: FieldMaps | None = None,
    ) -> None:
        self.streams = Streams(board)
        self.pictures = PictureStreams(pictures or Pictures())
        self._socket = _listening(host, port)
        self._server = uvicorn.Server(
            uvicorn.Config(
                page_app(
                    board, read_files(), self.streams, pictures=self.pictures, maps=maps or FieldMaps(), acting=acting
                ),
                http=BoundedConnection,
                ws="none",
                lifespan="off",
                loop="asyncio",
                interface="asgi3",
                log_config=None,
                access_log=False,
                proxy_headers=False,
                server_header=False,
                timeout_keep_alive=KEEP_ALIVE_S,
                timeout_graceful_shutdown=STOP_WITHIN_S,
                h11_max_incomplete_event_size=MAX_HEADER_BYTES,
            )
        )
        self._turned_s = time.monotonic()
        self._thread = threading.Thread(target=self._run, name="page-server", daemon=True)

    @property
    def port(self) -> int:
        """The port it listens on."""
        return int(self._socket.getsockname()[1])

    @property
    def serves(self) -> bool:
        """Its thread is there: uvicorn ends without an exception where it cannot begin."""
        return self._thread.is_alive()

    @property
    def moves(self) -> bool:
        """Its loop turns."""
        return time.monotonic() - self._turned_s < STILL_AFTER_S

    def __enter__(self) -> PageServer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.streams.stop()
        self.pictures.stop()
        self._server.should_exit = True
        self._thread.join(STOP_WITHIN_S + 1.0)
        self._socket.close()

    def _run(self) -> None:
        logging.getLogger("uvicorn").setLevel(logging.ERROR)  # a bad request is the asker's, not the journal's
        asyncio.run(self._serve())

    async def _serve(self) -> None:
        self.streams.start(asyncio.get_running_loop())
        self.pictures.start(asyncio.get_running_loop())
        turning = asyncio.create_task(self._turn())
        await self._server.serve(sockets=[self._socket])
        turning.cancel()

    async def _turn(self) -> None:
        while True:
            self._turned_s = time.monotonic()
            await asyncio.sleep(1.0)


def _listening(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((host, port))
        listening.listen(BACKLOG)
    except OSError as error:
        listening.close()
        raise LinkError(
            f"cannot serve the page on {host}:{port}: {error.strerror or error}; give another --listen HOST:PORT"
        ) from error
    return listening
