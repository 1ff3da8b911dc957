"""Who is alive: liveliness tokens. They say that a process and its link live, not that it makes progress."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Any

import zenoh

from conveyor import topics
from conveyor.delivery.bounded import CONFIGURED, UNKNOWN, Bounded, node_of

if TYPE_CHECKING:
    from conveyor.delivery.endpoint import Endpoint

ASK_EVERY_S = 10.0
"""Who lives is asked for so often, beside what is told."""


class Presence:
    """Names of the living nodes of one role, `MOST_KEYS` at most. `on_change` runs on Zenoh's thread: keep it short.

    Counters: `alive_refused_full`, tokens for which there is no room; `alive_refused_name`, of names no node can have.
    Zenoh may tell a token twice, which counts twice: who lives is asked for now and then, and an answer that comes
    after the end of the answers is told as a new token.

    Args:
        known: nodes ('role/name') that are kept before others when there is no room for all.
    """

    def __init__(
        self,
        node: Endpoint,
        role: str,
        *,
        on_change: Callable[[], None] | None = None,
        known: Collection[str] = (),
    ) -> None:
        self._lock = threading.Lock()
        self._role = role
        self._counters = node.counters
        self._names = Bounded[None](
            rank=lambda name: CONFIGURED if f"{role}/{name}" in known else UNKNOWN,
        )
        self._on_change = on_change
        self._session, self._key = node.session, topics.ALIVE.key(node.line, role=role, name="*")
        self._asked_s = time.monotonic()
        self._absent: set[str] = set()
        self._subscriber: Any = node.session.liveliness().declare_subscriber(
            self._key,
            zenoh.handlers.Callback(self._on_token, indirect=False),
            history=True,
        )

    def _on_token(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        if node_of(topics.ALIVE, key) is None:
            self._counters.add("alive_refused_name")
            return
        name = topics.ALIVE.parts(key)["name"]
        with self._lock:
            if sample.kind == zenoh.SampleKind.PUT:
                if not self._names.put(name, None):
                    self._counters.add("alive_refused_full")
            else:
                self._names.discard(name)
        if self._on_change:
            self._on_change()

    def _ask_now_and_then(self) -> None:
        """A session that was away for longer than its lease may be told of no token any more: two segmenters of six
        took all regressors for gone for the rest of a run. So who lives is asked for as well."""
        now_s = time.monotonic()
        with self._lock:
            if now_s - self._asked_s < ASK_EVERY_S:
                return
            self._asked_s = now_s
        found: set[str] = set()

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None and node_of(topics.ALIVE, key := str(reply.ok.key_expr)) is not None:
                found.add(topics.ALIVE.parts(key)["name"])

        with contextlib.suppress(zenoh.ZError):  # the session is closing
            self._session.liveliness().get(
                self._key, zenoh.handlers.Callback(on_reply, lambda: self._told(found), indirect=False)
            )

    def _told(self, found: set[str]) -> None:
        """All that an answer named are alive; who is missing from two answers in a row that named someone is not.

        The end of the answers may overtake them (Zenoh 1.10): on a loaded machine 3 of 40 questions for 5 tokens were
        answered by none of them, and half of those for 3000 by a part.
        """
        if not found:
            return  # no router, perhaps
        with self._lock:
            known = set(self._names.all())
            new = {name for name in found - known if self._names.put(name, None)}
            gone = (known - found) & self._absent
            self._absent = known - found - gone
            for name in gone:
                self._names.discard(name)
        if (new or gone) and self._on_change:
            self._on_change()

    def names(self) -> set[str]:
        """Names alive now."""
        self._ask_now_and_then()
        with self._lock:
            return set(self._names.all())

    def __contains__(self, name: object) -> bool:
        with self._lock:
            return name in self._names
