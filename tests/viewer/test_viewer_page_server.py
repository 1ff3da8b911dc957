"""The page's server over real sockets: what it sends, what it refuses, and that no client can hold it up."""

from __future__ import annotations

import http.client
import json
import re
import socket
import statistics
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

import viewer.page.app as app_module
import viewer.page.connections as connections_module
import viewer.page.streams as streams_module
from conveyor.errors import LinkError
from tests.viewer.page_states import good_state
from viewer.page.app import own_name
from viewer.page.board import Board
from viewer.page.files import read_files
from viewer.page.server import PageServer
from viewer.page.snapshot import snapshot
from viewer.page.streams import MAX_STREAMS

STATIC = Path(app_module.__file__).parent / "static"


@pytest.fixture
def board() -> Board:
    return Board(["north"])


@pytest.fixture
def page(board: Board) -> Iterator[PageServer]:
    with PageServer(board, host="127.0.0.1", port=0) as running:
        yield running


def ask(
    page: PageServer, path: str, *, method: str = "GET", host: str | None = None
) -> tuple[int, dict[str, str], bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=10)
    connection.request(method, path, headers={"Host": host} if host else {})
    answer = connection.getresponse()
    found = answer.status, {name.lower(): value for name, value in answer.getheaders()}, answer.read()
    connection.close()
    return found


def stream(page: PageServer) -> socket.socket:
    """A browser that listens; HTTP/1.0, so that the events come without chunk sizes between them."""
    channel = socket.create_connection(("127.0.0.1", page.port), 5)
    channel.sendall(b"GET /events HTTP/1.0\r\nHost: 127.0.0.1\r\n\r\n")
    return channel


def read_until(channel: socket.socket, wanted: bytes, *, within_s: float = 10.0) -> bytes:
    channel.settimeout(within_s)
    found = b""
    while wanted not in found:
        data = channel.recv(65536)
        assert data, f"closed before {wanted!r} came; got {found[:200]!r}"
        found += data
    return found


def test_every_file_comes_with_its_type_and_strict_headers(page: PageServer) -> None:
    for path in read_files():
        status, headers, body = ask(page, path)
        assert (status, len(body) > 0) == (200, True), path
        assert "default-src 'none'" in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["cache-control"] == "no-store"
    assert ask(page, "/page.js")[1]["content-type"].startswith("text/javascript")
    assert ask(page, "/", method="HEAD")[2] == b""


def test_the_page_needs_nothing_from_elsewhere() -> None:
    own = [file for file in STATIC.iterdir() if file.is_file()]
    for file in own:
        text = file.read_text(encoding="utf-8").replace("http://www.w3.org/2000/svg", "")
        assert not re.search(r"https?://|//cdn|@import|@font-face|\beval\(", text), file.name
        assert len(text.splitlines()) <= 200 or file.name == "words.json", file.name
    html = (STATIC / "index.html").read_text(encoding="utf-8")
    assert not re.search(r'(src|href)="/', html), "paths are relative: behind the proxy the page lives under /page/"
    named = set(re.findall(r'(?:src|href)="([^"#]+)"', html))
    scripts = {name for file in STATIC.glob("*.js") for name in re.findall(r'from "\./(.+?)"', file.read_text())}
    named |= {name for file in STATIC.glob("*.js") for name in re.findall(r'"(shipped/[^"]+)"', file.read_text())}
    shipped = {f"shipped/{file.name}" for file in (STATIC / "shipped").iterdir()}
    licences = {name for name in shipped if name.endswith(".txt")}
    assert {name.partition("-license")[0] for name in licences} == {
        name.partition(".")[0] for name in shipped - licences
    }
    assert named | scripts | {"index.html", "words.json"} | licences == {file.name for file in own} | shipped


def test_snapshots_come_as_events_as_soon_as_they_are_there(page: PageServer, board: Board) -> None:
    with stream(page) as channel:
        first = read_until(channel, b"\n\ndata: ")
        assert b"text/event-stream" in first
        board.put(snapshot(good_state()))
        started = time.monotonic()
        data = read_until(channel, b'"count":11590')
        assert time.monotonic() - started < 2.0
    text = data.rpartition(b"data: ")[2]
    assert b"\n" not in text.rstrip(b"\n"), "an event is one line"
    shown = json.loads(ask(page, "/snapshot.json")[2])["lines"][0]
    assert (shown["line"], shown["state"]) == ("north", "running")


def test_a_line_that_tells_no_more_is_told_to_be_old(page: PageServer, board: Board) -> None:
    board.put(snapshot(good_state()))
    deadline = time.monotonic() + 5
    while json.loads(ask(page, "/snapshot.json")[2])["lines"][0]["told_s"] < 1.0:
        assert time.monotonic() < deadline


@pytest.mark.parametrize(
    "path", ["/../server.py", "/..%2fserver.py", "/static/page.js", "//etc/passwd", "/events/", "/page.js/", "/%00"]
)
def test_nothing_else_can_be_asked_for(page: PageServer, path: str) -> None:
    assert ask(page, path)[0] == 404


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "CONNECT"])
def test_nothing_can_be_written(page: PageServer, method: str) -> None:
    assert ask(page, "/", method=method)[0] in (400, 405)


@pytest.mark.parametrize(
    ("host", "ours"),
    [
        ("127.0.0.1:9180", True),
        ("10.0.0.5", True),
        ("[::1]:9180", True),
        ("[fe80::1]", True),
        ("localhost:9180", True),
        (socket.gethostname(), True),
        ("evil.example", False),
        ("evil.example:9180", False),
        ("127.0.0.1.evil.example", False),
        ("", False),
    ],
)
def test_only_this_machines_own_names_are_answered(page: PageServer, host: str, ours: bool) -> None:
    assert own_name(host) == ours
    if host:
        assert ask(page, "/snapshot.json", host=host)[0] == (200 if ours else 421)


def test_too_many_browsers_are_told_so_and_leave_room_when_they_go(page: PageServer) -> None:
    with ExitStack() as stack:
        channels = [stack.enter_context(stream(page)) for _ in range(MAX_STREAMS)]
        for channel in channels:
            read_until(channel, b"data: ")
        with stream(page) as one_more:
            assert b" 503 " in read_until(one_more, b"\r\n")
        assert ask(page, "/")[0] == 200, "the page itself still comes"
    deadline = time.monotonic() + 10
    while True:
        with stream(page) as again:
            if b" 200 " in read_until(again, b"\r\n"):
                break
        assert time.monotonic() < deadline, "streams of browsers that left are free again"
        time.sleep(0.1)


def test_silent_sockets_keep_no_browser_out(page: PageServer, monkeypatch: pytest.MonkeyPatch) -> None:
    """48 sockets that sent nothing blocked the page once: the oldest silent one makes room."""
    monkeypatch.setattr(connections_module, "MAX_CONNECTIONS", 40)
    monkeypatch.setattr(connections_module, "REQUEST_WITHIN_S", 60.0)
    with ExitStack() as stack:
        silent = [stack.enter_context(socket.create_connection(("127.0.0.1", page.port), 5)) for _ in range(60)]
        for channel in silent[::2]:
            channel.sendall(b"GET / HTTP/1.1\r\nX-Slow: ")
        for _ in range(5):
            assert ask(page, "/")[0] == 200
        silent[0].settimeout(5)
        assert closed(silent[0]), "the oldest silent connection made room"


def test_a_connection_that_asks_for_nothing_is_closed(page: PageServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections_module, "REQUEST_WITHIN_S", 0.3)
    with socket.create_connection(("127.0.0.1", page.port), 5) as channel:
        channel.sendall(b"GET / HTTP/1.1\r\n")
        channel.settimeout(5)
        assert closed(channel)


def test_headers_without_end_are_refused(page: PageServer) -> None:
    with socket.create_connection(("127.0.0.1", page.port), 5) as channel:
        channel.settimeout(5)
        channel.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Long: " + b"x" * 100_000)
        assert b" 400 " in channel.recv(4096) or closed(channel)


def closed(channel: socket.socket) -> bool:
    """The other side ended the connection, in order or not."""
    try:
        return channel.recv(1) == b""
    except ConnectionError:
        return True


def test_a_frozen_browser_is_let_go(page: PageServer, board: Board, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streams_module, "SEND_WITHIN_S", 0.3)
    big = {**snapshot(good_state()), "line": "north", "padding": "x" * 2_000_000}
    with stream(page) as frozen:
        read_until(frozen, b"data: ")
        took_s = []
        deadline = time.monotonic() + 15
        for n in range(100):
            started = time.monotonic()
            board.put({**big, "n": n})
            took_s.append(time.monotonic() - started)
            if page.streams.open == 0:
                break
            assert time.monotonic() < deadline
            time.sleep(0.1)
        assert page.streams.open == 0
        assert statistics.median(took_s) < 0.1, "writers never wait for readers, of which each may take 0.3 s"


def test_a_port_that_is_taken_is_said(page: PageServer, board: Board) -> None:
    with pytest.raises(LinkError, match=f"cannot serve the page on 127.0.0.1:{page.port}.*--listen"):
        PageServer(board, host="127.0.0.1", port=page.port)
