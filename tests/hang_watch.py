"""Ends a test run that hangs where no timeout reaches it, and says where: in compiled code, or while it cleans up.

pytest-timeout raises once, and in Python code alone. A call of Zenoh, of a kernel or of a `finally` that never returns
held a whole CI run until CI itself gave up, and the log said nothing. A process of its own watches instead: it needs no
interpreter lock of the process that it watches, and the SIGABRT that it sends makes that one write where each of its
threads stands. pytest-xdist then names the test and goes on with another worker.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Generator

import pytest

GRACE_S = 90.0
"""So much longer than its timeout may a test take to clean up."""

WATCHER = """
import os, select, signal, sys
parent, timeout, test, rest = int(sys.argv[1]), None, "", b""
while True:
    if not select.select([0], [], [], timeout)[0]:
        os.write(2, f"\\n{test} did not end within {timeout:g} s, nor by its timeout: SIGABRT\\n".encode())
        os.kill(parent, signal.SIGABRT)
        break
    read = os.read(0, 65536)
    if not read:
        break
    *lines, rest = (rest + read).split(b"\\n")
    if lines:
        limit, _, test = lines[-1].decode().partition(" ")
        timeout = float(limit) if float(limit) else None
"""


class HangWatch:
    """A pytest plugin: its watcher hears of each test before it begins and when it has ended."""

    def __init__(self, *, grace_s: float = GRACE_S) -> None:
        self._grace_s = grace_s
        self._watcher: subprocess.Popen[bytes] | None = None

    def pytest_sessionstart(self) -> None:
        """Start the watcher; output is not captured yet."""
        command = [sys.executable, "-I", "-S", "-c", WATCHER, str(os.getpid())]
        self._watcher = subprocess.Popen(command, stdin=subprocess.PIPE, bufsize=0)

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        """Around one test, its fixtures included; pytest-timeout itself stops counting where a test has failed."""
        limit_s = timeout_s(item)
        self._tell(f"{limit_s + self._grace_s if limit_s else 0:g} {item.nodeid}")
        try:
            return (yield)
        finally:
            self._tell("0 -")

    def pytest_sessionfinish(self) -> None:
        """End the watcher."""
        if self._watcher is not None and self._watcher.stdin is not None:
            self._watcher.stdin.close()
            self._watcher.wait(30)

    def _tell(self, line: str) -> None:
        if self._watcher is not None and self._watcher.stdin is not None:
            self._watcher.stdin.write(line.encode(errors="replace") + b"\n")


def timeout_s(item: pytest.Item) -> float:
    """The timeout of a test: its own mark, else that of all; 0 where it has none."""
    mark = item.get_closest_marker("timeout")
    return float(mark.args[0] if mark else item.config.getini("timeout") or 0)
