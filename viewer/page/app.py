"""What the page answers: its files, the newest snapshot, events, pictures, and orders where it may give them."""

from __future__ import annotations

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
from viewer.page.files import File
from viewer.page.maps import FieldMaps
from viewer.page.streams import PictureStreams, Streams

HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; worker-src 'self'; style-src 'self'; img-src 'self'; "
        "connect-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
LOCAL_NAMES = frozenset({"localhost", socket.gethostname().lower(), f"{socket.gethostname().lower()}.local"})


def page_app(
    board: Board,
    files: Mapping[str, File],
    streams: Streams,
    *,
    pictures: PictureStreams,
    maps: FieldMaps,
    acting: Acting | None = None,
) -> ASGIApp:
    """The page as an ASGI app: files at their paths, /snapshot.json, /events, /pictures, /map.json; /order, to act."""

    async def file(request: Request) -> Response:
        found = files[request.url.path]
        return Response(found.content, media_type=found.kind)

    async def newest(_: Request) -> Response:
        return Response(board.newest()[1], media_type="application/json")

    async def field(request: Request) -> Response:
        return Response(maps.newest(request.query_params.get("line", "")), media_type="application/json")

    routes = [Route(path, file, methods=["GET"]) for path in files]
    routes += [Route("/snapshot.json", newest, methods=["GET"]), Route("/events", streams, methods=["GET"])]
    routes += [Route("/pictures", pictures, methods=["GET"]), Route("/map.json", field, methods=["GET"])]
    if acting is not None:
        routes.append(Route("/order", acting.__call__, methods=["POST"]))
    app = Starlette(routes=routes)
    app.router.redirect_slashes = False
    return OwnNamesOnly(app)


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
