"""Never lost on the way: a cached publisher whose subscribers ask again for what they missed.

Survives router kills, link cuts and frozen subscribers without ever blocking the sender; it does not survive the death
of the publishing process. What must survive that is kept in a log until acknowledged (`TrackEntry` and `Committed`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import zenoh
from zenoh import ext

from conveyor.delivery.gaps import Gaps
from conveyor.delivery.inbox import Inbox
from conveyor.delivery.priorities import zenoh_priority
from conveyor.errors import MessageError
from conveyor.messages import Message
from conveyor.topics import Topic

if TYPE_CHECKING:
    from conveyor.delivery.endpoint import Endpoint

M = TypeVar("M", bound=Message)
HEARTBEAT_S = 0.3
CACHE_MESSAGES = 4096
INBOX_MESSAGES = 65536


class ReliablePublisher:
    """Publishes messages that every present and soon returning subscriber gets, in order."""

    def __init__(self, node: Endpoint, topic: Topic, **parts: str) -> None:
        self._publisher: Any = ext.declare_advanced_publisher(
            node.session,
            topic.key(node.line, **parts),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh_priority(topic),
            cache=ext.CacheConfig(CACHE_MESSAGES),
            sample_miss_detection=ext.MissDetectionConfig(heartbeat=HEARTBEAT_S, sporadic_heartbeat=None),
            publisher_detection=True,
        )

    def put(self, message: Message) -> None:
        """Send `message`; it stays in the cache for those who missed it."""
        self.put_encoded(message.encode())

    def put_encoded(self, data: bytes) -> None:
        """Send a message that is encoded already."""
        self._publisher.put(data)

    def close(self) -> None:
        """Send no more, and forget the cache."""
        self._publisher.undeclare()


class ReliableSubscriber(Inbox[M]):
    """All messages of a topic, what was cached before it joined included; parts may be '*'."""

    def __init__(
        self,
        node: Endpoint,
        topic: Topic,
        message_type: type[M],
        *,
        capacity: int = INBOX_MESSAGES,
        history: bool = True,
        on_refused: Callable[[str, bytes, MessageError], None] | None = None,
        **parts: str,
    ) -> None:
        super().__init__(
            message_type,
            topic=topic,
            capacity=capacity,
            counters=node.counters,
            log=node.log,
            on_refused=on_refused,
        )
        gaps = Gaps(node.session, self.push, cache=CACHE_MESSAGES, lost=self._count_missed, log=node.log)
        self._subscriber = ext.declare_advanced_subscriber(
            node.session,
            topic.key(node.line, **parts),
            zenoh.handlers.Callback(gaps.push if history else self.push, indirect=False),
            history=ext.HistoryConfig(detect_late_publishers=True) if history else None,
            recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
        )
        if not history:  # else what Zenoh gave up is asked for again
            self._misses: Any = self._subscriber.sample_miss_listener(lambda miss: self._count_missed(int(miss.nb)))

    def _count_missed(self, count: int) -> None:
        """The sender's cache no longer holds what was missed, or does not answer: an error with a count."""
        self._counters.add(f"{self._name}_missed", count)
        self._log.error("%d messages of %s were lost for good: the sender no longer gives them", count, self._name)
