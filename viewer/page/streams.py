"""Server-sent events, for so many browsers at most: each gets the newest and skips the rest, a frozen one is let go.

Two kinds: the board's snapshots, and pictures of the cameras that a browser has on its screen.
"""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from typing import Any, Generic, TypeVar
from urllib.parse import parse_qs

from starlette.responses import PlainTextResponse
from starlette.types import Receive, Scope, Send

from conveyor.errors import ConfigError
from viewer.page.board import Board
from viewer.page.connections import abort
from viewer.page.pictures import Pictures, camera_of

MAX_STREAMS = 64
"""Browsers that watch at the same time. A stream is some kilobytes a second."""
MAX_PICTURE_STREAMS = 16
"""Browsers that look at pictures at the same time: up to some 90 kB a second for each camera on their screen."""
MAX_CAMERAS = 8
SEND_WITHIN_S = 5.0
"""A frozen browser's connection is closed after this; when it wakes up it asks again."""
BEAT_S = 2.0
"""A stream says something at least this often: the browser then knows that this server lives."""
START = {"type": "http.response.start", "status": 200}
HEADERS = [(b"content-type", b"text/event-stream; charset=utf-8"), (b"x-accel-buffering", b"no")]

S = TypeVar("S")


class Events(ABC, Generic[S]):
    """Streams of one kind. What a stream knows of its browser, `S`, begins with `begin` and ends with `end`."""

    def __init__(self, most: int) -> None:
        self.open = 0
        self._most = most
        self._changed = asyncio.Event()
        self._stopping = False
        self._loop: asyncio.AbstractEventLoop | None = None

    def start(self, loop: asyncio.AbstractEventLoop) -> None:
        """Hear of changes, which come from other threads."""
        self._loop = loop

    def stop(self) -> None:
        """End every stream, from any thread."""
        self._stopping = True
        self.changed()

    def changed(self) -> None:
        """There is something new; from any thread."""
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._wake)

    def _wake(self) -> None:
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()

    @abstractmethod
    def begin(self, scope: Scope) -> S:
        """What is asked for; raises ConfigError where that cannot be."""

    @abstractmethod
    def news(self, state: S) -> list[bytes]:
        """Events that this browser has not got yet, or must get as a sign of life."""

    def end(self, state: S) -> None:
        """The browser is gone."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One browser's stream, until it leaves, freezes, or the server stops."""
        if scope["method"] != "GET":
            await PlainTextResponse("Not Found", 404)(scope, receive, send)
            return
        if self.open >= self._most:
            await PlainTextResponse(f"{self._most} browsers watch already", 503)(scope, receive, send)
            return
        try:
            state = self.begin(scope)
        except ConfigError as error:
            await PlainTextResponse(str(error), 400)(scope, receive, send)
            return
        self.open += 1
        try:
            async with asyncio.TaskGroup() as tasks:
                gone = tasks.create_task(_disconnected(receive))
                tell = tasks.create_task(self._tell(send, state))
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
            self.end(state)

    async def _tell(self, send: Send, state: S) -> None:
        await send({**START, "headers": HEADERS})
        await _send(send, b"retry: 1000\n\n")
        while not self._stopping:
            changed = self._changed
            for event in self.news(state):
                await _send(send, event)
            try:
                await asyncio.wait_for(changed.wait(), BEAT_S)
            except TimeoutError:
                await _send(send, b": here\n\n")


class Streams(Events[None]):
    """The board: the newest snapshot of every line, whenever there is a new one, and as a sign of life."""

    def __init__(self, board: Board) -> None:
        super().__init__(MAX_STREAMS)
        self._board = board

    def start(self, loop: asyncio.AbstractEventLoop) -> None:
        """Hear of the board's changes."""
        super().start(loop)
        self._board.on_change = self.changed

    def stop(self) -> None:
        """End every stream; the board's changes are heard no more."""
        self._board.on_change = lambda: None
        super().stop()

    def begin(self, scope: Scope) -> None:
        """Everybody gets the same."""

    def news(self, state: None) -> list[bytes]:
        """The newest snapshot, also where it was told before."""
        return [f"data: {self._board.newest()[1]}\n\n".encode()]


class PictureStreams(Events[dict[tuple[str, str], int]]):
    """Pictures of the cameras that a browser asks for, `?see=LINE/CAMERA&see=...`; of each, the number it has got."""

    def __init__(self, pictures: Pictures) -> None:
        super().__init__(MAX_PICTURE_STREAMS)
        self._pictures = pictures

    def start(self, loop: asyncio.AbstractEventLoop) -> None:
        """Hear of new pictures."""
        super().start(loop)
        self._pictures.on_change = self.changed

    def stop(self) -> None:
        """End every stream; new pictures are heard of no more."""
        self._pictures.on_change = lambda: None
        super().stop()

    def begin(self, scope: Scope) -> dict[tuple[str, str], int]:
        """Somebody looks at these cameras from now on."""
        asked: Any = parse_qs(scope["query_string"].decode("latin-1")).get("see", [])
        cameras = dict.fromkeys((camera_of(each) for each in asked), 0)
        if not 0 < len(cameras) <= MAX_CAMERAS:
            raise ConfigError(f"ask for 1 to {MAX_CAMERAS} cameras, as ?see=LINE/CAMERA")
        self._pictures.look(cameras)
        return cameras

    def news(self, state: dict[tuple[str, str], int]) -> list[bytes]:
        """The newest picture of each camera, where it is another one than before."""
        found = []
        for camera, seen in state.items():
            number, event = self._pictures.newest(camera, after=seen)
            if number > seen:
                state[camera] = number
                found.append(event)
        return found

    def end(self, state: dict[tuple[str, str], int]) -> None:
        """No one looks here any more."""
        self._pictures.leave(state)


async def _send(send: Send, body: bytes) -> None:
    """Hand `body` to the connection; TimeoutError where the browser takes nothing."""
    await asyncio.wait_for(send({"type": "http.response.body", "body": body, "more_body": True}), SEND_WITHIN_S)


async def _disconnected(receive: Receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass
