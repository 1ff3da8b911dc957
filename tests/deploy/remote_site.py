"""Rerun's hub with its page, and the operator's page, behind a real nginx, as deploy/proxy sets it up."""

from __future__ import annotations

import base64
import http.client
import shutil
import ssl
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from conveyor.identity import Identity
from conveyor.messages import LoadAnswer
from conveyor.taken_port import free_port
from tests.conftest import ROOT, wait_until
from tuberline.certs import issue, make_authority
from viewer.page.acting import Acting
from viewer.page.board import Board
from viewer.page.server import PageServer
from viewer.rerun.launch import Ports, RerunProgram

USER, PASSWORD = "office", "harvest-moon"
TOKEN = "a-token-of-this-test"
READ = "/rerun.sdk_comms.v1alpha1.MessageProxyService/ReadMessages"
WRITE = "/rerun.sdk_comms.v1alpha1.MessageProxyService/WriteMessages"
GRPC_WEB = {"content-type": "application/grpc-web+proto", "x-grpc-web": "1"}
EMPTY_MESSAGE = bytes(5)
"""gRPC framing: no compression, length 0."""


@dataclass(frozen=True, slots=True)
class Proxy:
    """A proxy that listens, the hub behind it, and the board of the operator's page behind it."""

    port: int
    ca: Path
    url: str
    page_url: str
    hub: Ports
    board: Board

    def ask(
        self,
        path: str,
        *,
        method: str = "GET",
        password: str | None = PASSWORD,
        body: bytes | None = None,
        head: int = -1,
        more: dict[str, str] | None = None,
    ) -> tuple[int, dict[str, str], bytes]:
        """(status, headers, the first `head` bytes of the body) of one request; `password` None sends none."""
        connection = http.client.HTTPSConnection(
            "localhost", self.port, context=ssl.create_default_context(cafile=str(self.ca)), timeout=20
        )
        headers = dict(GRPC_WEB) if method == "POST" else {"accept-encoding": "gzip"}
        if password is not None:
            headers["authorization"] = "Basic " + base64.b64encode(f"{USER}:{password}".encode()).decode()
        headers |= more or {}
        try:
            connection.request(method, path, body=body, headers=headers)
            answer = connection.getresponse()
            return (
                answer.status,
                {k.lower(): v for k, v in answer.getheaders()},
                answer.read(None if head < 0 else head),
            )
        finally:
            connection.close()


def nginx_program() -> str:
    """The real nginx; the test is skipped loudly without one."""
    program = shutil.which("nginx", path="/usr/sbin:/usr/bin:/usr/local/sbin:/usr/local/bin")
    if program is None:
        pytest.skip("nginx is not installed (Debian: apt-get install nginx-light): the proxy was not tested")
    return program


@contextmanager
def remote_proxy() -> Iterator[Proxy]:
    """Hub, page and proxy on free ports of this machine, their files in a folder that nginx's own user may enter."""
    nginx_program()
    with tempfile.TemporaryDirectory(prefix="tuberline-proxy-") as folder:
        Path(folder).chmod(0o755)
        with _running(Path(folder)) as proxy:
            yield proxy


@contextmanager
def _running(folder: Path) -> Iterator[Proxy]:
    pytest.importorskip("cryptography", reason="certificates need tuberline[deploy]")
    certs, site, port = folder / "certs", folder / "site", free_port()
    make_authority(certs, site="north")
    issue(certs, Identity("router"), line="north", hosts=["localhost"])
    ports, board = Ports(free_port(), free_port()), Board(["replay"])
    acting = Acting(lambda _, order: LoadAnswer(order.request, True, load=1), lines=("replay",), token=TOKEN)
    page = PageServer(board, host="127.0.0.1", port=0, acting=acting)
    arguments = ["localhost", site, certs / "router.pem", certs / "router.key", port, ports.page, ports.hub, page.port]
    made = subprocess.run(
        [str(ROOT / "deploy/proxy/make"), *map(str, arguments)], capture_output=True, text=True, check=True, timeout=20
    )
    secret = subprocess.run(["openssl", "passwd", "-6", PASSWORD], capture_output=True, text=True, check=True).stdout
    (site / "passwords").write_text(f"{USER}:{secret}")
    (site / "passwords").chmod(0o644)
    with page, RerunProgram(ports, page=True):
        process = subprocess.Popen(
            [nginx_program(), "-c", str(site / "nginx.conf")], stderr=(folder / "nginx.log").open("wb")
        )
        try:
            proxy = Proxy(port, certs / "ca.pem", *made.stdout.split(), ports, board)
            wait_until(lambda: _answers(proxy, process, folder / "nginx.log"), what="nginx")
            yield proxy
        finally:
            process.terminate()
            process.wait(30)


def _answers(proxy: Proxy, process: subprocess.Popen[bytes], log: Path) -> bool:
    if process.poll() is not None:
        pytest.fail(f"nginx ended with {process.returncode}:\n{log.read_text()}")
    try:
        return proxy.ask("/", password=None)[0] == 401
    except OSError:
        return False
