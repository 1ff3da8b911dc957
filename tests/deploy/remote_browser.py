"""A real headless Chromium, driven through a pipe: Chrome's DevTools protocol without any package."""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-sync",
    "--disable-component-update",
    "--disable-dev-shm-usage",
    "--ignore-certificate-errors",
    "--window-size=1280,800",
)
"""The certificate is of the test's own authority, which this browser does not know."""
WEBGL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")
"""In software: each picture of the page goes through it then, for a third of the browser's CPU."""
NO_WEBGL = ("--disable-gpu",)


class BrowserError(Exception):
    """The browser refused a command."""


class Browser:
    """One page. Commands have long timeouts: software rendering of the viewer takes seconds a frame."""

    def __init__(self, to_browser: int, from_browser: int) -> None:
        self._to, self._from = to_browser, from_browser
        self._number = 0
        self._rest = b""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]

    def open(self, url: str, *, user: str, password: str) -> None:
        """Go there; returns when the browser has begun.

        The password is not put into the URL: a page with one in its own address may not fetch anything.
        """
        secret = base64.b64encode(f"{user}:{password}".encode()).decode()
        self.page("Network.enable")
        self.page("Network.setExtraHTTPHeaders", headers={"Authorization": f"Basic {secret}"})
        self.page("Page.navigate", url=url)

    def png(self) -> bytes | None:
        """The page as PNG; None while one page gives way to the next."""
        try:
            return base64.b64decode(self.page("Page.captureScreenshot", format="png")["data"])
        except BrowserError:
            return None

    def page(self, method: str, **params: Any) -> dict[str, Any]:
        """A command to the page."""
        return self.call(method, session=self._session, **params)

    def call(self, method: str, *, session: str = "", timeout_s: float = 120.0, **params: Any) -> dict[str, Any]:
        """A command and its answer; raises BrowserError with the browser's own words."""
        self._number += 1
        message = {
            "id": self._number,
            "method": method,
            "params": params,
            **({"sessionId": session} if session else {}),
        }
        os.write(self._to, json.dumps(message).encode() + b"\0")
        deadline = time.monotonic() + timeout_s
        while True:
            answer = self._next(deadline)
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise BrowserError(f"{method}: {answer['error']}")
                found: dict[str, Any] = answer["result"]
                return found

    def _next(self, deadline: float) -> dict[str, Any]:
        while b"\0" not in self._rest:
            if not select.select([self._from], [], [], max(0.0, deadline - time.monotonic()))[0]:
                pytest.fail("the browser did not answer in time")
            data = os.read(self._from, 1 << 20)
            if not data:
                pytest.fail("the browser is gone")
            self._rest += data
        one, _, self._rest = self._rest.partition(b"\0")
        message: dict[str, Any] = json.loads(one)
        return message


@contextmanager
def chromium(folder: Path, *, webgl: bool = True) -> Iterator[Browser]:
    """A browser with a profile of its own; the test is skipped loudly without one.

    Args:
        webgl: for pages that draw with it: maps, and the viewer's scenes.
    """
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("no Chromium (Debian: apt-get install chromium): the page was not looked at")
    their_in, to_browser = os.pipe()
    from_browser, their_out = os.pipe()
    shell = f'exec "$@" 3<&{their_in} 4>&{their_out}'
    flags = [*FLAGS, *(WEBGL if webgl else NO_WEBGL), "--remote-debugging-pipe", f"--user-data-dir={folder}"]
    process = subprocess.Popen(
        ["bash", "-c", shell, "sh", program, *flags],
        pass_fds=(their_in, their_out),
        stderr=(folder.parent / "chromium.log").open("wb"),
    )
    os.close(their_in)
    os.close(their_out)
    try:
        yield Browser(to_browser, from_browser)
    finally:
        process.terminate()
        process.wait(20)
        os.close(to_browser)
        os.close(from_browser)
