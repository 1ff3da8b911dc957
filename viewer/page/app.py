"""What the page answers: its files, the newest snapshot, one stream of events, and orders where it may give them."""

from __future__ import annotations

import asyncio
import ipaddress
import socket
from collections.abc import Mapping

from starlette.applications import Starlette
from starlette.datastructures import MutableHeaders
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from viewer.page.acting import Acting
from viewer.page.board import Board
from viewer.page.connections import abort
from viewer.page.files import File

MAX_STREAMS = 64
"""Browsers that watch at the same time. A stream is some kilobytes a second."""
SEND_WITHIN_S = 5.0
"""A frozen browser's connection is closed after this; when it wakes up it asks again."""
BEAT_S = 2.0
"""A stream says something at least this often: the browser then knows that this server lives."""
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
        "manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
LOCAL_NAMES = frozenset({"localhost", socket.gethostname().lower(), f"{socket.gethostname().lower()}.local"})


def page_app(board: Board, files: Mapping[str, File], streams: Streams, *, acting: Acting | None = None) -> ASGIApp:
    """The page as an ASGI app: every file at its path, /snapshot.json and /events; /order where there is `acting`."""

    async def file(request: Request) -> Response:
        found = files[request.url.path]
        return Response(found.content, media_type=found.kind)

    async def newest(_: Request) -> Response:
        return Response(board.newest()[1], media_type="application/json")

    routes = [Route(path, file, methods=["GET"]) for path in files]
    routes += [Route("/snapshot.json", newest, methods=["GET"]), Route("/events", streams, methods=["GET"])]
    if acting is not None:
        routes.append(Route("/order", acting.__call__, methods=["POST"]))
    app = Starlette(routes=routes)
    app.router.redirect_slashes = False
    return OwnNamesOnly(app)


class Streams:
    """The board as server-sent events, for at most `MAX_STREAMS` browsers; each gets the newest and skips the rest."""

    def __init__(self, board: Board) -> None:
        self.open = 0
        self._board = board
        self._changed = asyncio.Event()
        self._stopping = False
        self._loop: asyncio.AbstractEventLoop | None = None

    def start(self, loop: asyncio.AbstractEventLoop) -> None:
        """Hear of the board's changes, which come from other threads."""
        self._loop = loop

        def changed() -> None:
            loop.call_soon_threadsafe(self._wake)

        self._board.on_change = changed

    def stop(self) -> None:
        """End every stream, from any thread; the board's changes are heard no more."""
        self._board.on_change = lambda: None
        self._stopping = True
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._wake)

    def _wake(self) -> None:
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One browser's stream, until it leaves, freezes, or the server stops."""
        if scope["method"] != "GET":
            await PlainTextResponse("Not Found", 404)(scope, receive, send)
            return
        if self.open >= MAX_STREAMS:
            await PlainTextResponse(f"{MAX_STREAMS} browsers watch already", 503)(scope, receive, send)
            return
        self.open += 1
        try:
            async with asyncio.TaskGroup() as tasks:
                gone = tasks.create_task(_disconnected(receive))
                tell = tasks.create_task(self._tell(send))
                await asyncio.wait((gone, tell), return_when=asyncio.FIRST_COMPLETED)
                ended = tell.done() and tell.exception() is None
                gone.cancel()
                tell.cancel()
            if ended:
                await send({"type": "http.response.body", "body": b""})
        except* TimeoutError:
            abort(scope["client"])
        finally:
            self.open -= 1

    async def _tell(self, send: Send) -> None:
        headers = [(b"content-type", b"text/event-stream; charset=utf-8"), (b"x-accel-buffering", b"no")]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        await _send(send, b"retry: 1000\n\n")
        while not self._stopping:
            changed = self._changed
            _, text = self._board.newest()
            await _send(send, f"data: {text}\n\n".encode())
            try:
                await asyncio.wait_for(changed.wait(), BEAT_S)
            except TimeoutError:
                continue


async def _send(send: Send, body: bytes) -> None:
    """Hand `body` to the connection; TimeoutError where the browser takes nothing."""
    await asyncio.wait_for(send({"type": "http.response.body", "body": body, "more_body": True}), SEND_WITHIN_S)


async def _disconnected(receive: Receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass


class OwnNamesOnly:
    """Answers requests for this machine's own names, with strict headers.

    A page elsewhere must not reach this one through a browser by a trick of DNS.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Add the headers; refuse names that are not this machine's."""

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(HEADERS)
            await send(message)

        host = next((value.decode("latin-1") for name, value in scope["headers"] if name == b"host"), "")
        if own_name(host):
            await self._app(scope, receive, with_headers)
        else:
            refusal = PlainTextResponse("Ask by address, or by this machine's own name", 421)
            await refusal(scope, receive, with_headers)


def own_name(host: str) -> bool:
    """The name a browser asked for is an address or this machine's own name, with any port or none."""
    name = host.rpartition(":")[0] if host.rpartition(":")[2].isdigit() and not host.endswith("]") else host
    name = name.strip("[]").lower()
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return name in LOCAL_NAMES
    return True
