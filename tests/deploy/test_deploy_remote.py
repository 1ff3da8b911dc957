"""deploy/proxy with a real nginx before a real hub and a real operator's page: TLS and password needed, pages and
data come, no one writes.
"""

from __future__ import annotations

import base64
import gzip
import http.client
import json
import socket
import ssl
import subprocess
import zlib
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.deploy.remote_site import (
    EMPTY_MESSAGE,
    PASSWORD,
    READ,
    TOKEN,
    USER,
    WRITE,
    Proxy,
    nginx_program,
    remote_proxy,
)
from tests.viewer.page_states import good_state, loaded_state
from viewer.page.snapshot import snapshot

rerun = pytest.importorskip("rerun", reason="remote viewing needs tuberline[viewer]")


@pytest.fixture(scope="module")
def proxy() -> Iterator[Proxy]:
    with remote_proxy() as running:
        stream = rerun.RecordingStream("tuberline", recording_id="remote-test")
        stream.connect_grpc(running.hub.url)
        stream.log("load/weight_kg", rerun.Scalars(12.5))
        stream.flush(timeout_sec=10)
        yield running
        stream.disconnect()


@pytest.mark.parametrize(
    "path", ["/", "/re_viewer_bg.wasm", READ, WRITE, "/proxy", "/page/", "/page/events", "/page/snapshot.json"]
)
@pytest.mark.parametrize("password", [None, "guessed"])
def test_nothing_without_the_password(proxy: Proxy, path: str, password: str | None) -> None:
    assert proxy.ask(path, password=password)[0] == (403 if path in (WRITE, "/proxy") else 401)


def test_nothing_without_tls(proxy: Proxy) -> None:
    with socket.create_connection(("localhost", proxy.port), 5) as plain:
        plain.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert plain.recv(100).startswith(b"HTTP/1.1 400")


def test_its_certificate_is_checked_by_who_does_not_know_the_authority(proxy: Proxy) -> None:
    with (
        socket.create_connection(("localhost", proxy.port), 5) as plain,
        pytest.raises(ssl.SSLCertVerificationError),
    ):
        ssl.create_default_context().wrap_socket(plain, server_hostname="localhost")


def test_the_page_and_a_third_of_its_program_come(proxy: Proxy) -> None:
    status, _, page = proxy.ask("/", head=20000)
    assert status == 200
    status, headers, _ = proxy.ask("/re_viewer_bg.wasm", head=1000)
    assert (status, headers["content-encoding"]) == (200, "gzip")
    assert len(page) > 100


def test_the_hub_can_be_read(proxy: Proxy) -> None:
    status, headers, data = proxy.ask(READ, method="POST", body=EMPTY_MESSAGE, head=64)
    assert status == 200
    assert headers["content-type"].startswith("application/grpc-web")
    assert len(data) == 64, "what was logged comes through"


@pytest.mark.parametrize(
    "path", [WRITE, "/rerun.sdk_comms.v1alpha1.MessageProxyService/WriteTable", "/rerun.other/Any", "/proxy"]
)
def test_the_hub_cannot_be_written(proxy: Proxy, path: str) -> None:
    assert proxy.ask(path, method="POST", body=EMPTY_MESSAGE)[0] == 403


def test_the_operators_page_comes_with_its_figures(proxy: Proxy) -> None:
    proxy.board.put(snapshot(good_state("replay")))
    status, headers, page = proxy.ask("/page/")
    assert (status, headers["content-encoding"], b"<title>Tuberline" in gzip.decompress(page)) == (200, "gzip", True)
    assert "default-src 'none'" in headers["content-security-policy"]
    assert proxy.ask("/page")[0] == 301
    status, headers, events = proxy.ask("/page/events", head=400)
    assert (status, headers["content-type"]) == (200, "text/event-stream; charset=utf-8")
    assert headers["content-encoding"] == "gzip"
    assert zlib.decompressobj(31).decompress(events).startswith(b'retry: 1000\n\ndata: {"lines":[{"line":"replay"')


def test_an_event_that_says_nearly_the_same_takes_a_few_bytes_and_comes_at_once(proxy: Proxy) -> None:
    """Over 64 kbit/s the figures came 18 s late, and later with each second: an event of 24 loads has 11 kB."""
    first = loaded_state("replay")
    assert first.totals is not None
    first = replace(first, told=tuple(replace(first.told[0], number=n) for n in range(24, 0, -1)))
    proxy.board.put(snapshot(first))
    password = base64.b64encode(f"{USER}:{PASSWORD}".encode()).decode()
    headers = {"accept-encoding": "gzip", "authorization": f"Basic {password}"}
    authority = ssl.create_default_context(cafile=str(proxy.ca))
    connection = http.client.HTTPSConnection("localhost", proxy.port, context=authority, timeout=20)
    connection.request("GET", "/page/events", headers=headers)
    answer, reader = connection.getresponse(), zlib.decompressobj(31)

    def until(words: bytes) -> tuple[int, int]:
        """(bytes on the link, bytes of events) up to `words`."""
        packed, plain = 0, b""
        while words not in plain:
            piece = answer.read1(65536)
            packed, plain = packed + len(piece), plain + reader.decompress(piece)
        return packed, len(plain)

    until(b'"count":11590')
    later = replace(first, totals=replace(first.totals, count=11603, weight_g=1.0017 * first.totals.weight_g))
    proxy.board.put(snapshot(later))
    packed, plain = until(b'"count":11603')
    assert packed < plain / 15, f"{packed} bytes of {plain}"
    connection.close()


def test_half_requests_keep_no_one_out_and_are_let_go(proxy: Proxy) -> None:
    """256 of them, which need no password, kept everybody out for a minute, and longer where they were sent again."""
    anyone = ssl.create_default_context(cafile=str(proxy.ca))
    with ExitStack() as stack:
        halves = []
        for _ in range(280):
            plain = stack.enter_context(socket.create_connection(("localhost", proxy.port), 10))
            halves.append(stack.enter_context(anyone.wrap_socket(plain, server_hostname="localhost")))
            halves[-1].sendall(b"GET /page/ HTTP/1.1\r\nHost: localhost\r\nX-Slow: ")
        assert proxy.ask("/page/")[0] == 200
        halves[0].settimeout(30)
        assert halves[0].recv(100) == b""


def test_orders_need_the_password_the_token_and_the_page_itself(proxy: Proxy) -> None:
    order = json.dumps({"line": "replay", "action": "start", "request": "r1", "operator": "Anna"}).encode()

    def ask(**headers: str) -> int:
        more = {name.replace("_", "-"): value for name, value in headers.items()}
        return proxy.ask("/page/order", method="POST", body=order, more=more)[0]

    own = f"https://localhost:{proxy.port}"
    assert ask(x_tuberline_token=TOKEN, origin=own) == 200
    assert ask(x_tuberline_token="not-the-right-one-at-all", origin=own) == 401
    assert ask(x_tuberline_token=TOKEN, origin="https://elsewhere.example") == 403
    assert ask(origin=own) == 401
    assert proxy.ask("/page/order")[0] in (403, 404, 405)
    head = {"x-tuberline-token": TOKEN, "origin": own}
    assert proxy.ask("/page/order", method="POST", body=order, password=None, more=head)[0] in (401, 403)
    assert proxy.ask("/page/order", method="POST", body=b"x" * 9000, more=head)[0] == 413


@pytest.mark.parametrize("path", ["/", "/page/", "/page/events"])
def test_the_pages_take_no_uploads(proxy: Proxy, path: str) -> None:
    assert proxy.ask(path, method="POST", body=b"x")[0] == 403


def test_make_refuses_what_nginx_would_misread(tmp_path: Path) -> None:
    nginx_program()
    for host in ("a;b", "a b", "", "$host"):
        done = subprocess.run(
            [str(ROOT / "deploy/proxy/make"), host, str(tmp_path), "a", "b"],
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 2
        assert f"host '{host}'" in done.stderr


def test_make_refuses_a_folder_that_nginx_cannot_enter(tmp_path: Path) -> None:
    """It was to lie in /etc/tuberline, which install.sh closes: each request was answered by 500."""
    command = [str(ROOT / "deploy/proxy/make"), "localhost", str(tmp_path / "closed/proxy"), "a", "b"]
    (tmp_path / "closed").mkdir(mode=0o750)
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert f"make: {tmp_path / 'closed'} may be entered by its owner alone" in done.stderr
