"""Who is alive: liveliness tokens. They say that a process and its link live, not that it makes progress."""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Any

import zenoh

from conveyor import topics
from conveyor.delivery.bounded import CONFIGURED, UNKNOWN, Bounded, node_of

if TYPE_CHECKING:
    from conveyor.delivery.endpoint import Endpoint


class Presence:
    """Names of the living nodes of one role, `MOST_KEYS` at most. `on_change` runs on Zenoh's thread: keep it short.

    Counters: `alive_refused_full`, tokens for which there is no room; `alive_refused_name`, of names no node can have.

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
        self._subscriber: Any = node.session.liveliness().declare_subscriber(
            topics.ALIVE.key(node.line, role=role, name="*"),
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

    def names(self) -> set[str]:
        """Names alive now."""
        with self._lock:
            return set(self._names.all())

    def __contains__(self, name: object) -> bool:
        with self._lock:
            return name in self._names
