"""Keeps a line's processes running on one machine: a crashed node is restarted with a bounded back-off, and counted."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from tuberline.orphan import ENVIRONMENT

log = logging.getLogger("supervisor")

BACKOFF_FIRST_S = 0.5
BACKOFF_LIMIT_S = 10.0
HEALTHY_AFTER_S = 30.0
STOP_WITHIN_S = 4.0


@dataclass(frozen=True, slots=True)
class ProcessSpec:
    """One node: its name in reports and the `tuberline` arguments that start it."""

    name: str
    args: tuple[str, ...]


@dataclass(slots=True)
class _Child:
    spec: ProcessSpec
    process: subprocess.Popen[bytes] | None = None
    started: float = 0.0
    restarts: int = 0
    backoff_s: float = BACKOFF_FIRST_S
    not_before: float = 0.0
    done: bool = False
    exits: list[int] = field(default_factory=list)


class Supervisor:
    """Starts children in the order given, restarts the crashed, stops all on exit. Use as a context manager.

    Args:
        specs: what to run. A child that exits with 0 is done and not restarted.
        log_dir: each child's stderr goes to `<log_dir>/<name>.log`; None leaves it on this terminal.
        fatal_codes: exit codes that no restart mends (bad input or config): the child is not restarted.
    """

    def __init__(
        self, specs: Sequence[ProcessSpec], *, log_dir: Path | None = None, fatal_codes: frozenset[int] = frozenset({2})
    ) -> None:
        self._children = [_Child(spec) for spec in specs]
        self._log_dir = log_dir
        self._fatal = fatal_codes

    def __enter__(self) -> Supervisor:
        if self._log_dir:
            self._log_dir.mkdir(parents=True, exist_ok=True)
        for child in self._children:
            self._start(child)
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def poll(self) -> None:
        """Look after the children once: notice exits, restart what crashed and is due."""
        now = time.monotonic()
        for child in self._children:
            if child.process is not None and (code := child.process.poll()) is not None:
                self._exited(child, code, now)
            elif child.process is None and not child.done and now >= child.not_before:
                child.restarts += 1
                self._start(child)

    @property
    def restarts(self) -> dict[str, int]:
        """How often each child was restarted."""
        return {child.spec.name: child.restarts for child in self._children}

    @property
    def failures(self) -> dict[str, int]:
        """Children that ended with an exit code that no restart mends."""
        return {c.spec.name: c.exits[-1] for c in self._children if c.done and c.exits and c.exits[-1] != 0}

    def finished(self, name: str) -> bool:
        """The named child exited with 0."""
        return any(c.done and c.exits[-1:] == [0] for c in self._children if c.spec.name == name)

    def pid(self, name: str) -> int | None:
        """Process id of a running child."""
        return next((c.process.pid for c in self._children if c.spec.name == name and c.process), None)

    def log_tail(self, name: str, lines: int = 12) -> str:
        """The last lines a child wrote, where logs go to files."""
        path = self._log_dir / f"{name}.log" if self._log_dir else None
        if path is None or not path.is_file():
            return ""
        return "\n".join(path.read_text(errors="replace").splitlines()[-lines:])

    def stop(self) -> None:
        """SIGTERM to all, last started first; SIGKILL to whoever is still there after 4 s."""
        running = [c for c in reversed(self._children) if c.process is not None and c.process.poll() is None]
        routers = [c for c in running if c.spec.args[0] == "router"]
        self._stop_all([c for c in running if c not in routers])
        self._stop_all(routers)  # last, so that the others can say goodbye
        for child in self._children:
            child.done = True

    def _stop_all(self, children: Sequence[_Child]) -> None:
        for child in children:
            if child.process is not None:
                with contextlib.suppress(ProcessLookupError):
                    child.process.send_signal(signal.SIGTERM)
                    child.process.send_signal(signal.SIGCONT)
        deadline = time.monotonic() + STOP_WITHIN_S
        for child in children:
            if child.process is None:
                continue
            try:
                child.process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                log.error("%s did not stop on SIGTERM: killed", child.spec.name)
                child.process.kill()
                child.process.wait()

    def _start(self, child: _Child) -> None:
        stderr = None
        if self._log_dir:
            stderr = (self._log_dir / f"{child.spec.name}.log").open("ab")
        environment = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", **os.environ, ENVIRONMENT: str(os.getpid())}
        command = [sys.executable, "-m", "tuberline", *child.spec.args]
        child.process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=stderr, env=environment)
        if stderr:
            stderr.close()
        child.started = time.monotonic()

    def _exited(self, child: _Child, code: int, now: float) -> None:
        child.process = None
        child.exits.append(code)
        if code == 0 or code in self._fatal:
            child.done = True
            if code:
                log.error("%s gave up with exit code %d", child.spec.name, code)
            return
        if now - child.started > HEALTHY_AFTER_S:
            child.backoff_s = BACKOFF_FIRST_S
        child.not_before = now + child.backoff_s
        log.error(
            "%s ended with code %d; restart %d in %.1f s", child.spec.name, code, child.restarts + 1, child.backoff_s
        )
        child.backoff_s = min(2 * child.backoff_s, BACKOFF_LIMIT_S)
