"""Starts Rerun's own programs: the window, or a hub with its web page. They listen on this machine alone."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import shutil
import socket
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from conveyor.errors import ConfigError, LinkError
from viewer.rerun.sdk import INSTALL

HUB_PORT = 9876
PAGE_PORT = 9090
HUB_MEMORY = "256MiB"
WINDOW_MEMORY = "1GiB"
READY_WITHIN_S = 15.0
STOP_WITHIN_S = 0.4
THIS_MACHINE = "127.0.0.1"


@dataclass(frozen=True, slots=True)
class Ports:
    """Where a program listens: entries on `hub`, its page on `page`."""

    hub: int = HUB_PORT
    page: int = PAGE_PORT

    @property
    def url(self) -> str:
        """What a viewer process connects to."""
        return f"rerun+http://{THIS_MACHINE}:{self.hub}/proxy"

    @property
    def link(self) -> str:
        """What a person opens in a browser on this machine; dark, for weights on the light theme's labels are pale."""
        hub = f"rerun%2Bhttp%3A%2F%2F{THIS_MACHINE}%3A{self.hub}%2Fproxy"
        return f"http://{THIS_MACHINE}:{self.page}/?theme=dark&url={hub}"


class RerunProgram:
    """One of Rerun's programs as a child process, in a `with` block.

    Args:
        page: serve the web page instead of opening a window.
    """

    def __init__(self, ports: Ports, *, page: bool) -> None:
        self.ports = ports
        self._page = page
        self._child: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        for what, port in (("hub", self.ports.hub), *([("page", self.ports.page)] if self._page else [])):
            _must_be_free(port, what)
        self._child = subprocess.Popen(
            self._command(), stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, env={"RUST_LOG": "warn", **os.environ}
        )
        try:
            self._wait_until_ready()
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    @property
    def pid(self) -> int:
        """Process id of the running program."""
        if self._child is None:
            raise LinkError("Rerun's program was not started")
        return self._child.pid

    def ended(self) -> bool:
        """The program is gone: its window was closed, or it failed."""
        return self._child is None or self._child.poll() is not None

    def stop(self) -> None:
        """SIGTERM, and SIGKILL to one that does not listen."""
        if self._child is None or self._child.poll() is not None:
            return
        self._child.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._child.wait(STOP_WITHIN_S)
            return
        self._child.kill()
        self._child.wait()

    def _command(self) -> list[str]:
        command = [str(native_program()), "--bind", THIS_MACHINE, "--port", str(self.ports.hub)]
        if self._page:
            command += ["--serve-web", "--web-viewer-port", str(self.ports.page), "--server-memory-limit", HUB_MEMORY]
        else:
            command += ["--memory-limit", WINDOW_MEMORY, "--hide-welcome-screen"]
        # A viewer that is killed must not leave its hub behind, which would hold the port against the next one.
        setpriv = shutil.which("setpriv")
        return [setpriv, "--pdeathsig", "TERM", *command] if setpriv else command

    def _wait_until_ready(self) -> None:
        deadline = time.monotonic() + READY_WITHIN_S
        while time.monotonic() < deadline:
            if self.ended():
                code = self._child.returncode if self._child else None
                raise LinkError(
                    f"Rerun's program ended with code {code} instead of starting; its last words stand above. Without "
                    "a graphics driver or a display, serve the web page instead (watch --web)"
                )
            try:
                socket.create_connection((THIS_MACHINE, self.ports.hub), 0.2).close()
                return
            except OSError:
                time.sleep(0.05)
        raise LinkError(f"Rerun's program does not listen on port {self.ports.hub} after {READY_WITHIN_S:.0f} s")


def native_program() -> Path:
    """Rerun's binary. Not its console script: that is a wrapper, and killing it leaves the program running.

    Raises:
        ConfigError: rerun-sdk brought no binary for this machine.
    """
    spec = importlib.util.find_spec("rerun_cli")
    name = "rerun.exe" if sys.platform == "win32" else "rerun"
    places = [Path(folder) / name for folder in (spec.submodule_search_locations or [])] if spec else []
    for place in places:
        if place.is_file():
            return place
    raise ConfigError(f"rerun-sdk has no viewer program for this machine; {INSTALL}")


def _must_be_free(port: int, what: str) -> None:
    with contextlib.suppress(OSError), socket.create_connection((THIS_MACHINE, port), 0.2):
        raise LinkError(
            f"{what} port {port} is taken on this machine: another Rerun viewer runs there. Close it, or give another "
            f"port with --{what}-port, or show the line in it with --connect rerun+http://{THIS_MACHINE}:{port}/proxy"
        )
