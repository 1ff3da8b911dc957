"""An emulated link between two network devices: delay, jitter, loss, rate, a bounded queue, and cuts.

The kernel's own `netem` does most of this, but many kernels lack it; this one is the same everywhere and counts.
Needs root and /dev/net/tun.
"""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any, Self

from benchmarks.link_wire import Counts, LinkSettings
from conveyor.errors import TuberlineError

ROOT = Path(__file__).resolve().parents[1]
TUN = Path("/dev/net/tun")
ANSWER_WITHIN_S = 15.0
WAITING_PACKETS = 5000
"""Packets the kernel may hold for the emulator: a pause of its process must not look like a loss."""


def why_no_links() -> str:
    """Why links cannot be emulated here; empty where they can."""
    if os.geteuid() != 0:
        return "network namespaces and TAP devices need root"
    if not TUN.exists():
        return f"{TUN} does not exist: this kernel has no TAP devices"
    return ""


class EmulatedLink:
    """TAP devices `left` and `right` (to be moved into namespaces), joined while the `with` block lasts.

    Raises:
        TuberlineError: the devices cannot be made, or the emulator ended.
    """

    def __init__(self, left: str, right: str, settings: LinkSettings | None = None, *, seed: int = 1) -> None:
        self._names = (left, right)
        self.settings = settings or LinkSettings()
        self._seed = seed

    def __enter__(self) -> Self:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.link_emulator", *self._names, str(self._seed)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )
        try:
            self._answer()
            for name in self._names:
                subprocess.run(["ip", "link", "set", name, "txqueuelen", str(WAITING_PACKETS)], check=True)
            self.set(self.settings)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        for stream in (self._process.stdin, self._process.stdout, self._process.stderr):
            if stream:
                stream.close()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    @property
    def pid(self) -> int:
        """The emulator's process."""
        return self._process.pid

    def set(self, settings: LinkSettings) -> tuple[Counts, Counts]:
        """Make the link so from now on; the counts up to now, from left to right and back."""
        self.settings = settings
        return self._ask(asdict(settings))

    def counts(self) -> tuple[Counts, Counts]:
        """What became of the packets so far: from left to right, from right to left."""
        return self._ask({})

    def _ask(self, request: dict[str, Any]) -> tuple[Counts, Counts]:
        assert self._process.stdin
        try:
            self._process.stdin.write(json.dumps(request).encode() + b"\n")
            self._process.stdin.flush()
        except OSError as error:
            raise TuberlineError(f"the link emulator of {self._names} is gone: {error}") from error
        there, back = self._answer()
        return Counts(**there), Counts(**back)

    def _answer(self) -> Any:
        assert self._process.stdout
        assert self._process.stderr
        ready, _, _ = select.select([self._process.stdout], [], [], ANSWER_WITHIN_S)
        line = self._process.stdout.readline() if ready else b""
        if not line:
            self._process.kill()
            said = self._process.stderr.read().decode(errors="replace").strip().splitlines()
            raise TuberlineError(f"no link between {' and '.join(self._names)}: {said[-1] if said else 'no answer'}")
        return json.loads(line)
