"""Looks at a line without being part of it: no token, no counters of its own, no signal handling."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from typing import Any, Self

import zenoh

from conveyor import topics
from conveyor.config import LinkConfig
from conveyor.counters import CounterSet
from conveyor.delivery.bounded import node_of
from conveyor.delivery.kept import KeptSubscriber
from conveyor.delivery.presence import Presence
from conveyor.errors import LinkError
from conveyor.messages import Counters, Totals
from conveyor.session import open_client, refusal_of
from conveyor.topics import Topic

TRY_FOR_S = 1.0


class Observer:
    """A session that reads totals, counters and presence of `line`. Use as a context manager.

    Args:
        known: nodes ('role/name') that are kept before others where more tell of themselves than are remembered.
    """

    def __init__(self, link: LinkConfig, *, line: str, known: Collection[str] = ()) -> None:
        self.line = line
        self.known = known
        self.counters = CounterSet()
        self.log = logging.getLogger("observer")
        self._link = link

    def __enter__(self) -> Self:
        self.session = open_client(self._link, name="observer")
        self._alive = {role: Presence(self, role, known=self.known) for role in topics.ALIVE.senders}
        self._totals = KeptSubscriber(self, topics.TOTALS, Totals)
        self._counters = KeptSubscriber(
            self, topics.COUNTERS, Counters, known=self.known, alive=self.is_alive, role="*", name="*"
        )
        return self

    def __exit__(self, *_: object) -> None:
        self.session.close()  # type: ignore[no-untyped-call, unused-ignore]

    def totals(self) -> Totals | None:
        """The line's newest totals."""
        return next(iter(self._totals.latest().values()), None)

    def wait_totals(self, timeout_s: float) -> bool:
        """Wait for totals newer than those last read."""
        return self._totals.wait(timeout_s)

    def nodes(self) -> dict[str, Counters]:
        """Newest counters by 'role/name'; a report that names another node than its key does is left out."""
        reports = ((node_of(topics.COUNTERS, key), c) for key, c in self._counters.latest().items())
        return {node: c for node, c in reports if node == f"{c.role}/{c.name}"}

    def alive(self) -> set[str]:
        """'role/name' of every node whose token is there."""
        return {f"{role}/{name}" for role, presence in self._alive.items() for name in presence.names()}

    def is_alive(self, node: str) -> bool:
        """The token of `node` ('role/name') is there."""
        role, _, name = node.partition("/")
        return role in self._alive and name in self._alive[role]

    def query(self, topic: Topic, *, parameters: str = "", timeout_s: float = 3.0) -> Any:
        """The JSON answer of a queryable of this line.

        Raises:
            LinkError: no one answered in time, or the answer is an error or no JSON.
        """
        selector = topic.key(self.line) + (f"?{parameters}" if parameters else "")
        replies = self.session.get(selector, timeout=timeout_s, consolidation=zenoh.ConsolidationMode.NONE)
        for reply in replies:
            if reply.ok is not None:
                try:
                    return json.loads(reply.ok.payload.to_bytes())
                except (ValueError, RecursionError) as error:
                    raise LinkError(f"{selector}: the answer is no JSON: {error}") from error
            if reply.err is not None:
                raise LinkError(f"{selector}: {refusal_of(reply.err)}")
        raise LinkError(
            f"no one answered {selector} within {timeout_s:g} s: is the aggregator of line '{self.line}' up?"
        )


@contextmanager
def observer_when_there(
    link: LinkConfig, *, line: str, meanwhile: Callable[[], None], within_s: float = float("inf")
) -> Iterator[Observer]:
    """An observer of `line` once its router answers; until then `meanwhile` is called every second, and may raise.

    Raises:
        LinkError: no router within `within_s`.
    """
    deadline = time.monotonic() + within_s
    observer = Observer(link.model_copy(update={"connect_timeout_s": TRY_FOR_S}), line=line)
    while True:
        try:
            opened = observer.__enter__()
            break
        except LinkError:
            if time.monotonic() > deadline:
                raise
            meanwhile()
    try:
        yield opened
    finally:
        opened.__exit__()
