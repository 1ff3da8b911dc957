"""Routers for tests that need one and do not harm it: one process of a test session serves them all.

Each is a router of its own at an address of its own, as `tuberline router` opens it. A process for each takes nearly
half a second of processor time, and there are some 490 in a run of all tests.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

SERVE = """
import sys
from conveyor.config import LinkConfig
from conveyor.session import open_router

routers = {}
for line in sys.stdin:
    order, endpoint = line.split()
    if order == "open":
        routers[endpoint] = open_router(LinkConfig(router=endpoint))
    else:
        routers.pop(endpoint).close()
    print(order, endpoint, flush=True)
for router in routers.values():
    router.close()
"""


class Routers:
    """Opens and closes routers in a process of its own, started with the first of them."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None

    @contextmanager
    def at(self, endpoint: str) -> Iterator[None]:
        """A router listens at `endpoint` meanwhile."""
        self._tell("open", endpoint)
        try:
            yield
        finally:
            self._tell("close", endpoint)

    def stop(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.communicate(timeout=30)
            self._process = None

    def _tell(self, order: str, endpoint: str) -> None:
        if self._process is None:
            command = [sys.executable, "-c", SERVE]
            self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(f"{order} {endpoint}\n")
        process.stdin.flush()
        if process.stdout.readline() != f"{order} {endpoint}\n":
            process.kill()
            process.wait(30)
            self._process = None
            raise RuntimeError(f"the tests' routers: '{order} {endpoint}' failed; their process wrote why")
