"""Who lives under a name already: two nodes of one name would mix their messages.

A name counts as taken only while somebody proves to be alive there: what a dead process left behind goes away by
itself, and is waited for.
"""

from __future__ import annotations

import threading
import time
from typing import Any

import zenoh

from conveyor import topics
from conveyor.errors import LinkError, MessageError, TakenError
from conveyor.messages import Counters

ASK_S = 2.0
LEASE_MARGIN_S = 2.0
REPORTS_APART_S = 0.7
"""Two reports this far apart were sent by a living process; what a frozen router gives out late comes at once."""
SAME_AGE_S = 2.0
LOOK_EVERY_S = 0.1


class Namesake:
    """Listens to the reports of other processes under this node's name.

    Args:
        session: of the node.
        line: its line.
        role: its role.
        name: its name.
        host: this process's host, as its own reports say it.
        pid: this process.
    """

    def __init__(self, session: zenoh.Session, *, line: str, role: str, name: str, host: str, pid: int) -> None:
        self._session = session
        self._line, self._role, self._name = line, role, name
        self._self = (host, pid)
        self._token = topics.ALIVE.key(line, role=role, name=name)
        self._lock = threading.Lock()
        self._first: tuple[float, Counters] | None = None
        self._living: Counters | None = None
        self._subscriber: Any = session.declare_subscriber(
            topics.COUNTERS.key(line, role=role, name=name),
            zenoh.handlers.Callback(self._on_report, indirect=False),
            allowed_origin=zenoh.Locality.REMOTE,
        )

    def _on_report(self, sample: zenoh.Sample) -> None:
        try:
            report = Counters.decode(sample.payload.to_bytes())
        except MessageError:
            return  # its sender is no node of this version
        if (report.host, report.pid) == self._self:
            return
        now_s = time.monotonic()
        with self._lock:
            first = self._first
            if first is None or (first[1].host, first[1].pid) != (report.host, report.pid):
                self._first = (now_s, report)
            elif now_s - first[0] >= REPORTS_APART_S and report.uptime_s > first[1].uptime_s:
                self._living = report

    def check_free(self, *, lease_s: float, stop: threading.Event) -> None:
        """Return when no one lives under this name.

        Raises:
            TakenError: somebody does; says who.
            LinkError: a token is there that does not go, and no one reports.
        """
        deadline = time.monotonic() + lease_s + LEASE_MARGIN_S
        while self._token_is_there() and not stop.is_set():
            self._raise_if_living()
            if time.monotonic() > deadline:
                raise LinkError(
                    f"a {self._role} '{self._name}' of line '{self._line}' shows its token and reports nothing: "
                    "it stands still; end it"
                )
            stop.wait(LOOK_EVERY_S)

    def older(self, uptime_s: float) -> str:
        """Who lives under this name longer than this process, in words; empty where no one does."""
        with self._lock:
            other = self._living
            self._living = None
        if other is None:
            return ""
        ahead_s = other.uptime_s - uptime_s
        older = ahead_s > 0 if abs(ahead_s) > SAME_AGE_S else (other.host, other.pid) < self._self
        return self._who(other) if older else ""

    def _raise_if_living(self) -> None:
        with self._lock:
            other = self._living
        if other is not None:
            raise TakenError(self._who(other))

    def _token_is_there(self) -> bool:
        return any(reply.ok is not None for reply in self._session.liveliness().get(self._token, timeout=ASK_S))

    def _who(self, other: Counters) -> str:
        return (
            f"a {self._role} '{self._name}' of line '{self._line}' lives already: process {other.pid} on host "
            f"{other.host}, run {other.run}, for {other.uptime_s:.0f} s. Stop it, or give this one another name"
        )
