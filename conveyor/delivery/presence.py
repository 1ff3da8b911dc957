"""Who is alive: liveliness tokens. They say that a process and its link live, not that it makes progress."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import zenoh

from conveyor import topics

if TYPE_CHECKING:
    from conveyor.delivery.endpoint import Endpoint


class Presence:
    """The names of the living nodes of one role. `on_change` runs on Zenoh's thread: keep it short."""

    def __init__(self, node: Endpoint, role: str, *, on_change: Callable[[], None] | None = None) -> None:
        self._lock = threading.Lock()
        self._names: set[str] = set()
        self._on_change = on_change
        self._subscriber: Any = node.session.liveliness().declare_subscriber(
            topics.ALIVE.key(node.line, role=role, name="*"),
            zenoh.handlers.Callback(self._on_token, indirect=False),
            history=True,
        )

    def _on_token(self, sample: zenoh.Sample) -> None:
        name = topics.ALIVE.parts(str(sample.key_expr))["name"]
        with self._lock:
            if sample.kind == zenoh.SampleKind.PUT:
                self._names.add(name)
            else:
                self._names.discard(name)
        if self._on_change:
            self._on_change()

    def names(self) -> set[str]:
        """Names alive now."""
        with self._lock:
            return set(self._names)
