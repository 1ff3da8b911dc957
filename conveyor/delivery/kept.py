"""Kept: the newest value of each key, which late joiners get too."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Generic, TypeVar

import zenoh
from zenoh import ext

from conveyor.delivery.bounded import MOST_KEYS, Bounded, node_of, ranks
from conveyor.delivery.priorities import zenoh_priority
from conveyor.delivery.refusals import Refusals
from conveyor.errors import MessageError
from conveyor.messages import Message
from conveyor.topics import Topic

if TYPE_CHECKING:
    from conveyor.delivery.endpoint import Endpoint

M = TypeVar("M", bound=Message)
HEARTBEAT_S = 0.5


class KeptPublisher:
    """Publishes a state; its newest value stays available while this process lives."""

    def __init__(self, node: Endpoint, topic: Topic, **parts: str) -> None:
        self._publisher = ext.declare_advanced_publisher(
            node.session,
            topic.key(node.line, **parts),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh_priority(topic),
            cache=ext.CacheConfig(1),
            sample_miss_detection=ext.MissDetectionConfig(heartbeat=HEARTBEAT_S, sporadic_heartbeat=None),
            publisher_detection=True,
        )

    def put(self, message: Message) -> None:
        """Replace the value."""
        self._publisher.put(message.encode())


class KeptSubscriber(Generic[M]):
    """The newest value of every key that matches, `MOST_KEYS` at most; parts may be '*'.

    Counters: `kept_refused_full`, messages of keys for which there is no room; `kept_refused_name`, of keys whose names
    no node can have.

    Args:
        known: nodes ('role/name') that are kept before others when there is no room for all; after them those that
            are `alive`.
    """

    def __init__(
        self,
        node: Endpoint,
        topic: Topic,
        message_type: type[M],
        *,
        known: Collection[str] = (),
        alive: Callable[[str], bool] = lambda _: False,
        most: int = MOST_KEYS,
        **parts: str,
    ) -> None:
        self._type = message_type
        self._topic = topic
        self._counters = node.counters
        self._refusals = Refusals(topic, name=topic.name, counters=node.counters, log=node.log)
        self._values = Bounded[tuple[float, M]](most=most, rank=ranks(topic, known=known, alive=alive))
        self._changed = threading.Condition()
        self._version = 0
        self._seen = 0
        self._subscriber = ext.declare_advanced_subscriber(
            node.session,
            topic.key(node.line, **parts),
            zenoh.handlers.Callback(self._on_sample, indirect=False),
            history=ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
            recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
        )

    def _on_sample(self, sample: zenoh.Sample) -> None:
        key, arrived_s = str(sample.key_expr), time.monotonic()
        if node_of(self._topic, key) is None:
            self._counters.add("kept_refused_name")
            return
        try:
            message = self._type.decode(sample.payload.to_bytes())
        except MessageError as error:
            self._refusals.refuse(key, error)
            return
        with self._changed:
            if not self._values.put(key, (arrived_s, message)):
                self._counters.add("kept_refused_full")
                return
            self._version += 1
            self._changed.notify_all()

    def latest(self) -> dict[str, M]:
        """Newest value by key."""
        return {key: message for key, (_, message) in self.arrivals().items()}

    def arrivals(self) -> dict[str, tuple[float, M]]:
        """The same, each with the moment at which it came, seconds of the monotonic clock."""
        with self._changed:
            self._seen = self._version
            return self._values.all()

    def wait(self, timeout_s: float) -> bool:
        """Wait until something changed since the last `latest()`; False when nothing did."""
        with self._changed:
            return self._changed.wait_for(lambda: self._version != self._seen, timeout_s)
