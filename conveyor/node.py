"""The life of a process: session, liveliness token, counters once a second, stop on a signal, stall detection.

with Node("segmenter", "front", config=config, run=run) as node:
    while not node.stop.is_set():
        ...
        node.progress()
"""

from __future__ import annotations

import contextlib
import faulthandler
import logging
import os
import socket
import sys
import threading
import time
from types import TracebackType
from typing import Any, Self

import zenoh

from conveyor import __version__, crash, topics
from conveyor.config import LineConfig
from conveyor.counters import CounterSet
from conveyor.delivery.kept import KeptPublisher
from conveyor.errors import FAULT, PERMANENT
from conveyor.heap import GIVE_BACK_EVERY_S, give_back, resident_mib
from conveyor.logs import flush_outputs
from conveyor.messages import Counters
from conveyor.notify import notify
from conveyor.session import join_router
from conveyor.signals import when_told_to_end
from conveyor.taken import Namesake
from conveyor.topics import check_name

STOP_WITHIN_S = 2.0
STALL_AFTER_S = 5.0
STUCK_AFTER_S = 15.0
"""No Python thread ran for so long: some native call holds the interpreter lock. The process tells where, and ends,
before a manager that misses its heartbeat for 20 s ends it without a word."""


class Node:
    """One process of a line. Enter it in the main thread: it takes over SIGTERM and SIGINT."""

    def __init__(self, role: str, name: str, *, config: LineConfig, run: str, announce: bool = True) -> None:
        self.role = role
        self.name = check_name(name, what=role)
        self.config = config
        self.line = config.name
        self.run = check_name(run, what="run")
        self.stop = threading.Event()
        self.counters = CounterSet()
        self.log = logging.getLogger(f"{role}/{name}")
        self._announce_now = announce
        self._token: Any = None
        self._started = time.monotonic()
        self._progressed = time.monotonic()
        self._stalled = False
        self._last_word = ""
        self._reporting = threading.Lock()
        self._reporter: threading.Thread | None = None
        self._left = threading.Event()

    def __enter__(self) -> Self:
        """Join the line.

        Raises:
            TakenError: a node of this name lives already.
        """
        when_told_to_end(self._told_to_end)
        session = join_router(self.config.link, name=f"{self.role}/{self.name}", stop=self.stop, log=self.log)
        if session is None:
            raise SystemExit(0)
        self.session = session
        try:
            self._open()
        except BaseException:
            self._close_session()
            raise
        return self

    def _open(self) -> None:
        """Make sure that this node is alone under its name, then report, and announce it."""
        self._namesake = Namesake(
            self.session, line=self.line, role=self.role, name=self.name, host=socket.gethostname(), pid=os.getpid()
        )
        self._namesake.check_free(lease_s=self.config.link.lease_ms / 1000, stop=self.stop)
        self._counters_out = KeptPublisher(self, topics.COUNTERS, role=self.role, name=self.name)
        self._progressed = time.monotonic()
        self._put_off_watchdog()
        self._reporter = threading.Thread(target=self._report, name="counters", daemon=True)
        self._reporter.start()
        if self._announce_now:
            self.announce()
        self.log.info("started run=%s pid=%d router=%s", self.run, os.getpid(), self.config.link.router)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            self._last_word = "failed"
            self._leave_within(STOP_WITHIN_S, f"after {error!r}", code=getattr(error, "exit_code", FAULT))
        self.stop.set()
        if self._reporter is not None:
            self._reporter.join()
        crash.leaving.set()
        if self._token is not None:
            self._token.undeclare()
        self._close_session()
        crash.leaving.clear()
        self._left.set()
        self.log.info("stopped after %.1f s", time.monotonic() - self._started)

    def _close_session(self) -> None:
        try:
            self.session.close()  # type: ignore[no-untyped-call, unused-ignore]
        except zenoh.ZError as error:  # on a bad link the goodbye may not get through
            self.log.warning("its session did not close: %s", error)

    def announce(self) -> None:
        """Show the liveliness token: this node is ready for work."""
        if self._token is None:
            key = topics.ALIVE.key(self.line, role=self.role, name=self.name)
            self._token = self.session.liveliness().declare_token(key)
            notify("READY=1")

    def progress(self) -> None:
        """Say that the node's loop turns; a loop that does not for 5 s is reported as stalled."""
        self._progressed = time.monotonic()

    @property
    def uptime_s(self) -> float:
        """Seconds since the node was made."""
        return time.monotonic() - self._started

    def _report(self) -> None:
        given_back = time.monotonic()
        while not self.stop.wait(1.0):
            self._put_off_watchdog()
            self._watch_progress()
            self._watch_name()
            self.report_now()
            if time.monotonic() - given_back >= GIVE_BACK_EVERY_S:
                given_back = time.monotonic()
                give_back()
        faulthandler.cancel_dump_traceback_later()
        self._last_word = self._last_word or "ended"
        self.report_now()

    def report_now(self) -> None:
        """Publish the counters now, for a level that somebody waits for; otherwise they go out once a second."""
        with self._reporting:  # an older snapshot must not come after a newer one
            self._publish_counters()

    def _put_off_watchdog(self) -> None:
        """Its thread is one of C: it needs no interpreter lock to end a process in which nothing else runs."""
        if sys.__stderr__ is not None:
            with contextlib.suppress(OSError, ValueError):  # no file behind it: then there is no watchdog
                faulthandler.dump_traceback_later(STUCK_AFTER_S, exit=True, file=sys.__stderr__)

    def _watch_progress(self) -> None:
        still_s = time.monotonic() - self._progressed
        if still_s < STALL_AFTER_S:
            notify("WATCHDOG=1")
        if (still_s >= STALL_AFTER_S) != self._stalled:
            self._stalled = not self._stalled
            if self._stalled:
                self.counters.add("stalls")
                self.log.error("no progress for %.1f s", still_s)
            else:
                self.log.warning("makes progress again")

    def _publish_counters(self) -> None:
        values, gauges = self.counters.snapshot()
        resident = resident_mib()
        gauges = {**gauges, **({} if resident is None else {"resident_mib": resident})}
        self._counters_out.put(
            Counters(
                role=self.role,
                name=self.name,
                run=self.run,
                pid=os.getpid(),
                host=socket.gethostname(),
                version=__version__,
                uptime_s=self.uptime_s,
                values=values,
                gauges={**gauges, "clock_unix_s": time.time()},  # `doctor` compares the clocks of the hosts
                status=self._last_word or ("stalled" if self._stalled else "ok"),
            )
        )

    def _watch_name(self) -> None:
        """Of two nodes that started under one name at once, or at the two ends of a cut link, the younger one goes."""
        other = self._namesake.older(self.uptime_s)
        if other:
            self.log.error("%s", other)
            self._end(PERMANENT)

    def _told_to_end(self, number: int) -> None:
        self.stop.set()
        self._leave_within(STOP_WITHIN_S, f"of signal {number}", code=FAULT)

    def _leave_within(self, seconds: float, since: str, *, code: int) -> None:
        """Nothing that hangs while this node leaves keeps it alive."""

        def guard() -> None:
            if not self._left.wait(seconds):
                self.log.error("did not stop within %.0f s %s: ending at once", seconds, since)
                self._end(code)

        threading.Thread(target=guard, name="leave", daemon=True).start()

    @staticmethod
    def _end(code: int) -> None:
        flush_outputs()
        os._exit(code)
