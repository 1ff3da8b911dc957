"""Pictures of the belt: made while a browser shows them and no longer, bounded, and really drawn."""

from __future__ import annotations

import base64
import json
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager

import cv2
import numpy as np
import pytest

from conveyor import topics
from conveyor.config import LineConfig, LinkConfig
from conveyor.delivery import LatestPublisher
from conveyor.messages import Outline, Picture
from conveyor.node import Node
from conveyor.taken_port import free_port
from tests.conftest import wait_until
from tests.deploy.remote_browser import Browser
from tests.viewer.page_states import good_state
from tests.viewer.test_viewer_page_browser import browser, js, until
from tests.viewer.test_viewer_page_line import page as page_process
from tests.viewer.test_viewer_page_server import ask
from viewer.page.board import Board
from viewer.page.pictures import Pictures
from viewer.page.server import PageServer
from viewer.page.snapshot import snapshot
from viewer.page.streams import MAX_CAMERAS, MAX_PICTURE_STREAMS

__all__ = ["browser"]
WIDTH, HEIGHT = 120, 60
RED = (10, 20, 230)


def picture(camera: str = "left", seq: int = 7, drop: str = "") -> Picture:
    """A red belt with a counted tuber of 182 g and a clod."""
    image = np.full((HEIGHT, WIDTH, 3), RED, np.uint8)
    jpeg = np.asarray(cv2.imencode(".jpg", image)[1], np.uint8).ravel()
    outlines = (
        Outline((20, 10, 50, 10, 50, 50, 20, 50), "counted", 182.4),
        Outline((80, 20, 100, 20, 100, 40, 80, 40), "lump"),
    )
    return Picture(camera, "monday", seq, 1, WIDTH, HEIGHT, jpeg, () if drop else outlines, drop)


@contextmanager
def looking(port: int, *cameras: str) -> Iterator[socket.socket]:
    """A browser that shows these cameras."""
    with socket.create_connection(("127.0.0.1", port), 10) as channel:
        query = "&".join(f"see={camera}" for camera in cameras)
        channel.sendall(f"GET /pictures?{query} HTTP/1.0\r\nHost: 127.0.0.1\r\n\r\n".encode())
        channel.settimeout(30)
        yield channel


def next_event(channel: socket.socket) -> dict[str, object]:
    found = b""
    while b"data: " not in found or not found.endswith(b"\n\n"):
        data = channel.recv(65536)
        assert data, found[:200]
        found += data
    told: dict[str, object] = json.loads(found.rpartition(b"data: ")[2])
    return told


@pytest.mark.graph
def test_pictures_are_asked_for_while_somebody_looks(link: LinkConfig) -> None:
    config = LineConfig(name="north", link=link)
    port = free_port()
    with page_process(link, port, "north") as shown, Node("segmenter", "left", config=config, run="monday") as node:
        wait_until(lambda: shown.lines(), what="the page", timeout_s=60)
        out = LatestPublisher(node, topics.PICTURE, camera="left")
        other = LatestPublisher(node, topics.PICTURE, camera="right")
        assert not out.has_listener
        with looking(port, "north/left") as first, looking(port, "north/left") as second:
            wait_until(lambda: out.has_listener, what="somebody looks", timeout_s=60)
            assert not other.has_listener, "at that camera, and at no other"
            out.put(picture())
            for channel in (first, second):
                told = next_event(channel)
                assert (told["line"], told["camera"], told["seq"]) == ("north", "left", 7)
                assert told["outlines"] == [
                    ["counted", 182, [20, 10, 50, 10, 50, 50, 20, 50]],
                    ["lump", None, [80, 20, 100, 20, 100, 40, 80, 40]],
                ]
                image = cv2.imdecode(np.frombuffer(base64.b64decode(str(told["jpeg"])), np.uint8), cv2.IMREAD_COLOR)
                assert image is not None
                assert image.shape == (HEIGHT, WIDTH, 3)
        wait_until(lambda: not out.has_listener, what="no one looks any more", timeout_s=60)


def test_who_may_look_and_at_how_much_is_bounded() -> None:
    pictures = Pictures()
    with PageServer(Board(["north"]), host="127.0.0.1", port=0, pictures=pictures) as page:
        for asked in ("", "?see=north", "?see=north/..", "?see=north/*", "?see=*/left"):
            assert ask(page, f"/pictures{asked}")[0] == 400, asked
        many = "&".join(f"see=north/c{n}" for n in range(MAX_CAMERAS + 1))
        assert ask(page, f"/pictures?{many}")[0] == 400
        assert ask(page, "/pictures?see=north/left", method="POST")[0] in (404, 405)
        pictures.put("north", picture())
        assert pictures.newest(("north", "left")) == (0, b""), "nothing is kept that no one looks at"
        channels = [looking(page.port, "north/left") for _ in range(MAX_PICTURE_STREAMS)]
        opened = [channel.__enter__() for channel in channels]
        wait_until(lambda: page.pictures.open == MAX_PICTURE_STREAMS, what="all places are taken", timeout_s=20)
        assert ask(page, "/pictures?see=north/left")[0] == 503
        for channel in opened:
            channel.close()
        wait_until(lambda: pictures.wanted("north") == set(), what="all of them left", timeout_s=20)


def colour_at(browser: Browser, x: float, y: float) -> list[int]:
    """Of the canvas, at a share of its width and height."""
    spot = f"Math.round({x} * c.width), Math.round({y} * c.height), 1, 1"
    pixels = f"document.querySelector('canvas').getContext('2d').getImageData({spot}).data"
    found = js(browser, f"(() => {{ const c = document.querySelector('canvas'); return [...{pixels}]; }})()")
    return [int(value) for value in found[:3]]


@pytest.mark.graph
def test_the_picture_is_drawn_with_its_outlines_and_grows_old(browser: Browser) -> None:
    board, pictures = Board(["north"]), Pictures()
    board.put(snapshot(good_state()))
    with PageServer(board, host="127.0.0.1", port=0, pictures=pictures) as page:
        browser.page("Page.navigate", url=f"http://127.0.0.1:{page.port}/")
        until(lambda: pictures.wanted("north") == {"left", "right"}, what="both cameras are on the screen")
        pictures.put("north", picture())
        until(lambda: js(browser, "document.querySelector('canvas').dataset.outlines") == "2", what="the picture")
        blue, green, red = RED
        assert colour_at(browser, 0.05, 0.1) == pytest.approx([red, green, blue], abs=12), "the picture itself"
        assert colour_at(browser, 20.5 / WIDTH, 30 / HEIGHT)[1] > 180, "the counted tuber's line is green"
        said = js(browser, "document.querySelector('canvas').getAttribute('aria-label')")
        assert said == "Belt under camera left: 1 counted, 0 not decided yet, 1 refused"
        board.put(snapshot(good_state()))

        def notes() -> str:
            board.put(snapshot(good_state()))
            return str(js(browser, "document.querySelector('.camera .note').textContent"))

        until(lambda: "No new picture for" in notes(), what="it is told that it is old")
        js(browser, "document.querySelector('main').style.display = 'none'")
        until(lambda: pictures.wanted("north") == set(), what="nothing is asked for that is not on the screen")


@pytest.mark.graph
def test_an_old_picture_is_old_for_who_comes_later(browser: Browser) -> None:
    """A browser counted a picture's age from its own arrival: a camera that had stopped looked live after a reload."""
    board, pictures = Board(["north"]), Pictures()
    board.put(snapshot(good_state()))
    with (
        PageServer(board, host="127.0.0.1", port=0, pictures=pictures) as page,
        looking(page.port, "north/left") as one,
    ):
        wait_until(lambda: pictures.wanted("north") == {"left"}, what="somebody looks", timeout_s=20)
        pictures.put("north", picture())
        came_s = time.monotonic()
        assert next_event(one)["age_s"] == pytest.approx(0.0, abs=1.0)
        wait_until(lambda: time.monotonic() - came_s > 4.0, what="an old picture")
        browser.page("Page.navigate", url=f"http://127.0.0.1:{page.port}/")
        until(lambda: js(browser, "document.querySelector('canvas')?.dataset.outlines") == "2", what="the picture")

        def note() -> str:
            board.put(snapshot(good_state()))
            return str(js(browser, "document.querySelector('.camera .note').textContent"))

        until(lambda: "No new picture for" in note(), what="how old it is")
        noted = note()
        assert int("".join(filter(str.isdigit, noted))) >= 4, noted
        with looking(page.port, "north/left") as later:
            assert float(str(next_event(later)["age_s"])) >= 4.0
