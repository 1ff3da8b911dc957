"""Keeps a line's processes running on one machine: what crashes or stands still is started again, and counted."""

from __future__ import annotations

import contextlib
import logging
import signal
import subprocess
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from conveyor.direct import ENVIRONMENT as DIRECT
from conveyor.errors import PASSING, PERMANENT
from conveyor.files import unwritable
from tuberline.direct_folder import DirectFolder
from tuberline.forks import ForkServer, Process, alone
from tuberline.heartbeat import Heartbeat
from tuberline.own_time import OwnTime

log = logging.getLogger("supervisor")

BACKOFF_FIRST_S = 0.5
BACKOFF_LIMIT_S = 10.0
PASSING_LIMIT_S = 30.0
"""A full disk or a missing camera is looked for this often at least."""
HEALTHY_AFTER_S = 30.0
STOP_WITHIN_S = 4.0
LOOK_EVERY_S = 0.1
LOOK_AT_WAITS_EVERY_S = 1.0
TOLD_AGAIN_AFTER_S = 2.0
"""Who ends a whole line or a terminal tells its nodes, too, and sometimes first."""
MOST_PATIENCE = 8
"""Each standstill doubles the time for the next one up to this factor: what only is slow gets done at last."""
WORD = "tuberline: "
"""A sentence that a process ends with begins so."""
NOT_LOOKED_S = 2.0
"""This process itself stood still for longer: that says nothing about the others."""


@dataclass(frozen=True, slots=True)
class ProcessSpec:
    """One node: its name in reports and the `tuberline` arguments that start it."""

    name: str
    args: tuple[str, ...]

    @property
    def is_router(self) -> bool:
        """It is the line's router."""
        return self.args[0] == "router"

    @property
    def config(self) -> Path | None:
        """The file that it reads when it starts."""
        return Path(self.args[self.args.index("--config") + 1]) if "--config" in self.args else None

    @property
    def config_changed_ns(self) -> int:
        """When that file was written last, nanoseconds; 0 where it is not there."""
        try:
            return self.config.stat().st_mtime_ns if self.config is not None else 0
        except OSError:
            return 0


@dataclass(slots=True)
class _Child:
    spec: ProcessSpec
    process: Process | None = None
    heartbeat: Heartbeat | None = None
    own_time: OwnTime | None = None
    started: float = 0.0
    restarts: int = 0
    crashes: int = 0
    standstills: int = 0
    backoff_s: float = BACKOFF_FIRST_S
    not_before: float = 0.0
    done: bool = False
    config_ns: int = 0
    exits: list[int] = field(default_factory=list)


class Supervisor:
    """Starts children in the order given, restarts the crashed and the stuck, stops all on exit. A context manager.

    A thread of its own watches from the first moment. A child that exits with 0 is done, unless somebody else told it
    to end; one that exits with `PERMANENT` gave up until its config changes; every other one is started again. A
    standstill is one in the child's own time: what waits for a processor is slow, and starting it again would only
    cost it what it has done.

    Args:
        specs: what to run.
        log_dir: each child's stderr goes to `<log_dir>/<name>.log`; None leaves it on this terminal.
        forks: the process that children are forked from, where it was begun earlier; it is closed with the rest.
    """

    def __init__(
        self, specs: Sequence[ProcessSpec], *, log_dir: Path | None = None, forks: ForkServer | None = None
    ) -> None:
        self._children = [_Child(spec) for spec in specs]
        self._log_dir = log_dir
        self._direct: DirectFolder | None = None
        self._forks = forks
        self._lock = threading.RLock()
        self._stopping = threading.Event()
        self._looked_s = 0.0
        self._looked_at_waits_s = 0.0
        self._waited_s = 0.0
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Supervisor:
        if self._log_dir:
            self._log_dir.mkdir(parents=True, exist_ok=True)
        self._looked_s = time.monotonic()
        self._direct = DirectFolder()
        try:
            if self._forks is None:
                self._forks = ForkServer.if_usable(self._roles)
            for child in self._children:
                self._start(child)
            self._thread = threading.Thread(target=self._watch, name="watch", daemon=True)
            self._thread.start()
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def poll(self) -> None:
        """Look after the children once: notice exits and standstills, restart what is due."""
        with self._lock:
            if self._stopping.is_set():
                return
            now = time.monotonic()
            self._forgive(now)
            self._look_at_waits(now)
            for child in self._children:
                if child.process is not None and (code := child.process.poll()) is not None:
                    self._exited(child, code, now)
                elif child.process is not None and child.heartbeat is not None:
                    self._watch_heartbeat(child, child.heartbeat, now)
                elif not child.done and now >= child.not_before:
                    self._start_again(child, now)
                elif child.done and child.exits[-1:] != [0] and child.spec.config_changed_ns != child.config_ns:
                    log.warning("%s is started again: %s was changed", child.spec.name, child.spec.config)
                    child.done = False
                    self._start_again(child, now)

    @property
    def specs(self) -> list[ProcessSpec]:
        """What it runs."""
        return [child.spec for child in self._children]

    @property
    def restarts(self) -> dict[str, int]:
        """How often each child was restarted."""
        return {child.spec.name: child.restarts for child in self._children}

    @property
    def crashes(self) -> dict[str, int]:
        """How often each child ended by a fault; errors that may pass are not counted."""
        return {child.spec.name: child.crashes for child in self._children}

    @property
    def failures(self) -> dict[str, int]:
        """Children that ended with an exit code that no restart cures."""
        with self._lock:
            return {c.spec.name: c.exits[-1] for c in self._children if c.done and c.exits and c.exits[-1] != 0}

    @property
    def own_time_s(self) -> float:
        """A steady clock that stands still while some child waits for a processor: slowness takes none of its time."""
        return time.monotonic() - self._waited_s

    def finished(self, name: str) -> bool:
        """The named child exited with 0."""
        return any(c.done and c.exits[-1:] == [0] for c in self._children if c.spec.name == name)

    def pid(self, name: str) -> int | None:
        """Process id of a running child."""
        return next((c.process.pid for c in self._children if c.spec.name == name and c.process), None)

    @property
    def stumbled(self) -> set[str]:
        """Children that ended other than well, or had to be ended, at least once."""
        return {child.spec.name for child in self._children if any(child.exits)}

    @property
    def disk_trouble(self) -> str:
        """Why nothing more goes onto the disk of the logs, and how to fix it; empty where it can, and without a log."""
        trouble = unwritable(self._log_dir) if self._log_dir else ""
        return trouble and f"{self._log_dir}: {trouble}"

    def log_tail(self, name: str, lines: int = 12) -> str:
        """The last lines a child wrote, where logs go to files."""
        path = self._log_dir / f"{name}.log" if self._log_dir else None
        if path is None or not path.is_file():
            return ""
        return "\n".join(path.read_text(errors="replace").splitlines()[-lines:])

    def last_words(self, name: str) -> str:
        """The error that a child ended with, without its 'tuberline: '; else the last lines it wrote."""
        return self._said(name) or self.log_tail(name)

    def _said(self, name: str) -> str:
        """What a child wrote from its last sentence on; empty where its last lines hold none."""
        _, word, said = f"\n{self.log_tail(name)}".rpartition(f"\n{WORD}")
        return said if word else ""

    def stop(self) -> None:
        """SIGTERM to all, last started first; SIGKILL to those still there after 4 s."""
        self._stopping.set()
        # A signal may come while the thread starts: then it cannot be joined, and ends by itself.
        if self._thread is not None and self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join()
        with self._lock:
            running = [c for c in reversed(self._children) if c.process is not None and c.process.poll() is None]
            self._stop_all([c for c in running if not c.spec.is_router])
            self._stop_all([c for c in running if c.spec.is_router])  # last, so that the others can say goodbye
            for child in self._children:
                child.done = True
                if child.heartbeat is not None:
                    child.heartbeat.close()
        if self._forks is not None:
            self._forks.close()
        if self._direct is not None:
            self._direct.close()

    def _watch(self) -> None:
        while not self._stopping.wait(LOOK_EVERY_S):
            self.poll()

    def _forgive(self, now: float) -> None:
        """No one heard the children while this process was stopped or its machine asleep."""
        if now - self._looked_s > NOT_LOOKED_S:
            for child in self._children:
                if child.heartbeat is not None and child.own_time is not None:
                    child.heartbeat.forgive(child.own_time.at(now))
        self._looked_s = now

    def _look_at_waits(self, now: float) -> None:
        if now - self._looked_at_waits_s >= LOOK_AT_WAITS_EVERY_S:
            self._looked_at_waits_s = now
            own_times = [c.own_time for c in self._children if c.process is not None and c.own_time is not None]
            self._waited_s += max((own_time.look() for own_time in own_times), default=0.0)

    def _watch_heartbeat(self, child: _Child, heartbeat: Heartbeat, now: float) -> None:
        still = heartbeat.standstill(now if child.own_time is None else child.own_time.at(now))
        if still and child.process is not None:
            log.error("%s %s: killed, to be started again", child.spec.name, still)
            child.standstills += 1
            heartbeat.close()
            child.process.kill()

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

    def _start_again(self, child: _Child, now: float) -> None:
        if child.exits[-1:] == [0]:
            log.error("%s was told to end, though not by this line: it is started again", child.spec.name)
        try:
            self._start(child)
            child.restarts += 1
        except OSError as error:  # no memory, no file handle, no room for the log
            log.error("%s cannot be started: %s", child.spec.name, error.strerror or error)
            self._put_off(child, now, limit_s=PASSING_LIMIT_S)

    def _start(self, child: _Child) -> None:
        if child.heartbeat is not None:
            child.heartbeat.close()
        child.heartbeat = Heartbeat(time.monotonic(), patience=min(2**child.standstills, MOST_PATIENCE))
        direct = str(self._direct.path) if self._direct is not None and self._has_both_ends(child.spec) else ""
        environment = {**child.heartbeat.environment, DIRECT: direct}
        log_file = self._log_dir / f"{child.spec.name}.log" if self._log_dir else None
        child.config_ns = child.spec.config_changed_ns
        child.process = self._process(child.spec.args, environment, log_file)
        child.heartbeat.forgive(time.monotonic())  # it could say nothing before it was forked, which may take a while
        child.own_time = OwnTime(child.process.pid)
        child.started = time.monotonic()

    def _process(self, args: Sequence[str], environment: Mapping[str, str], log_file: Path | None) -> Process:
        if self._forks is None:
            return alone(args, environment=environment, log=log_file)
        try:
            return self._forks.start(args, environment=environment, log=log_file)
        except ConnectionError as error:
            log.error("%s: another one is started", error)
            self._forks.close()
            self._forks = ForkServer(self._roles)
            return self._forks.start(args, environment=environment, log=log_file)

    @property
    def _roles(self) -> list[str]:
        return [child.spec.args[0] for child in self._children]

    def _has_both_ends(self, spec: ProcessSpec) -> bool:
        """The camera and its segmenter are both ours: only then they meet in our folder."""
        ends = {"camera": "segmenter", "segmenter": "camera"}
        other = (ends.get(spec.args[0], ""), *spec.args[1:])
        return any(child.spec.args == other for child in self._children)

    def _exited(self, child: _Child, code: int, now: float) -> None:
        child.process = None
        child.exits.append(code)
        if code == 0 and child.heartbeat is not None and child.heartbeat.told_to_end(now):
            child.not_before = now + TOLD_AGAIN_AFTER_S
            return
        # A router that held its port and finds it taken when it comes back waits for it.
        if code == 0 or (code == PERMANENT and not (child.spec.is_router and child.restarts)):
            child.done = True
            if code:
                again = f"; it is started again when {child.spec.config} changes" if child.spec.config else ""
                log.error("%s gave up with exit code %d%s%s", child.spec.name, code, self._why(child), again)
            return
        if now - child.started > HEALTHY_AFTER_S:
            child.backoff_s = BACKOFF_FIRST_S
        passing = code == PASSING
        child.crashes += not passing
        log.error(
            "%s %s%s; restart %d in %.1f s",
            child.spec.name,
            "cannot work now" if passing else f"ended with code {code}",
            self._why(child) if passing or self.disk_trouble else "",
            child.restarts + 1,
            child.backoff_s,
        )
        self._put_off(child, now, limit_s=PASSING_LIMIT_S if passing else BACKOFF_LIMIT_S)

    def _why(self, child: _Child) -> str:
        """Its own last sentence; where its log could not take that, what is wrong with the log's disk."""
        told = self.disk_trouble or self._said(child.spec.name).partition("\n")[0]
        return told and f": {told}"

    @staticmethod
    def _put_off(child: _Child, now: float, *, limit_s: float) -> None:
        child.not_before = now + child.backoff_s
        child.backoff_s = min(2 * child.backoff_s, limit_s)
