"""The operator's page over a bad link and among many tabs: what it asks for, and that it finds back by itself."""

from __future__ import annotations

import asyncio
import re
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from tests.deploy.remote_browser import Browser, chromium
from tests.viewer.page_states import good_state, totals
from tests.viewer.test_viewer_page_browser import js, text, until, until_told
from viewer.page.board import Board
from viewer.page.server import PageServer
from viewer.page.snapshot import snapshot

FIND_BACK_S = 40.0


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with chromium(tmp_path_factory.mktemp("browser") / "profile", webgl=False) as running:
        yield running


class Radio:
    """A link to a port of this machine, on which all takes `late_s`. After `hole` the connections of before carry
    nothing and are not closed.
    """

    def __init__(self, to_port: int) -> None:
        self.late_s = 0.0
        self._to_port = to_port
        self._alive = asyncio.Event()

    async def carry(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One connection, both ways."""
        alive = self._alive
        alive.set()
        back, there = await asyncio.open_connection("127.0.0.1", self._to_port)
        await asyncio.gather(self._pipe(reader, there, alive), self._pipe(back, writer, alive))

    async def _pipe(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, alive: asyncio.Event) -> None:
        pieces: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()
        writing = asyncio.create_task(self._write(pieces, writer, alive))
        while data := await reader.read(65536):
            pieces.put_nowait((time.monotonic() + self.late_s, data))
        pieces.put_nowait((0.0, b""))
        await writing

    async def _write(
        self, pieces: asyncio.Queue[tuple[float, bytes]], writer: asyncio.StreamWriter, alive: asyncio.Event
    ) -> None:
        while True:
            due_s, data = await pieces.get()
            await asyncio.sleep(due_s - time.monotonic())
            await alive.wait()
            if not data:
                writer.close()
                return
            writer.write(data)

    def hole(self) -> None:
        """From now on only new connections carry anything."""
        self._alive.clear()
        self._alive = asyncio.Event()


@contextmanager
def radio(to_port: int) -> Iterator[tuple[Radio, asyncio.AbstractEventLoop, int]]:
    """A link, its loop, and the port at which it takes connections."""
    loop = asyncio.new_event_loop()
    found = Radio(to_port)
    server = loop.run_until_complete(asyncio.start_server(found.carry, "127.0.0.1", 0))
    thread = threading.Thread(target=loop.run_forever, daemon=True)
    thread.start()
    try:
        yield found, loop, server.sockets[0].getsockname()[1]
    finally:
        asyncio.run_coroutine_threadsafe(_leave_all(), loop).result(10)
        loop.call_soon_threadsafe(loop.stop)
        thread.join(10)


async def _leave_all() -> None:
    others = asyncio.all_tasks() - {asyncio.current_task()}
    for task in others:
        task.cancel()
    await asyncio.gather(*others, return_exceptions=True)


def test_a_connection_that_is_dead_and_not_closed_is_left_for_a_new_one(browser: Browser) -> None:
    """After a hole in the radio of 30 s the page had no contact for 16 s more, behind the proxy 24 s, and behind a
    router that had forgotten the connection for minutes."""
    board = Board(["north"])
    with PageServer(board, host="127.0.0.1", port=0) as page, radio(page.port) as (link, loop, port):
        browser.page("Page.navigate", url=f"http://127.0.0.1:{port}/")
        until_told(browser, board, snapshot(good_state()), "Page connected", "11 590")
        loop.call_soon_threadsafe(link.hole)
        later = snapshot(replace(good_state(), totals=totals(count=11600)))

        def found_back() -> bool:
            board.put(later)
            return "Page connected" in text(browser) and "11 600" in text(browser)

        until(lambda: "No contact: last heard" in text(browser), what="the page says that it has no contact")
        until(found_back, what="the page finds back", within_s=FIND_BACK_S)


def test_figures_that_waited_on_a_slow_link_are_old_when_they_come(browser: Browser) -> None:
    """Over 64 kbit/s they came 18 s late, one each second, and the page said that it was connected."""
    board = Board(["north"])
    with PageServer(board, host="127.0.0.1", port=0) as page, radio(page.port) as (link, _, port):
        browser.page("Page.navigate", url=f"http://127.0.0.1:{port}/")
        until_told(browser, board, snapshot(good_state()), "Page connected", "11 590")
        link.late_s = 6.0
        waited = snapshot(replace(good_state(), totals=totals(count=11600)))

        def old() -> bool:
            board.put(waited)
            return "11 600" in text(browser) and "last heard" in text(browser)

        until(old, what="figures that are told as old", within_s=20)


def test_a_tab_in_the_background_holds_no_connection(browser: Browser, tmp_path: Path) -> None:
    """A browser has six connections to a server: the seventh tab of the page stayed white for good."""
    board = Board(["north"])
    with PageServer(board, host="127.0.0.1", port=0) as page:
        browser.page("Page.navigate", url=f"http://127.0.0.1:{page.port}/")
        until_told(browser, board, snapshot(good_state()), "Page connected", "11 590")
        front = browser.call("Target.createTarget", url=f"http://127.0.0.1:{page.port}/?lang=de")["targetId"]
        browser.call("Target.activateTarget", targetId=front)
        session = browser.call("Target.attachToTarget", targetId=front, flatten=True)["sessionId"]
        said = {"session": session, "expression": "document.body?.innerText", "returnByValue": True}

        def shown() -> bool:
            board.put(snapshot(good_state()))
            found = browser.call("Runtime.evaluate", **said)["result"].get("value")
            return "11 590" in re.sub(r"\s", " ", str(found))

        until(shown, what="another tab shows the line")
        assert js(browser, "document.hidden")
        until(lambda: page.streams.open == 1, what="only the tab in front listens")
        browser.call("Target.closeTarget", targetId=front)
        until(lambda: not js(browser, "document.hidden"), what="the first tab is in front again")
        until_told(browser, board, snapshot(replace(good_state(), totals=totals(count=11700))), "11 700", "connected")
        until(lambda: page.streams.open == 1, what="it alone listens")
