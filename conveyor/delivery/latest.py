"""Latest wins: dropped on a full link, overwritten in a small ring at the receiver; gaps show in sequence numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

import zenoh

from conveyor.delivery.inbox import Inbox
from conveyor.delivery.priorities import zenoh_priority
from conveyor.messages import Message
from conveyor.topics import Topic

if TYPE_CHECKING:
    from conveyor.delivery.endpoint import Endpoint

M = TypeVar("M", bound=Message)


class LatestPublisher:
    """Publishes messages that no one waits for."""

    def __init__(self, node: Endpoint, topic: Topic, **parts: str) -> None:
        self._publisher: Any = node.session.declare_publisher(
            topic.key(node.line, **parts),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh_priority(topic),
        )

    def put(self, message: Message, *, codec: str = "raw") -> None:
        """Send `message` if the link takes it now. Returns at once; a loss shows at the receiver as a gap."""
        self.put_encoded(message.encode(codec=codec))

    def put_encoded(self, data: bytes) -> None:
        """Send a message that is encoded already."""
        self._publisher.put(data)

    def leave(self) -> None:
        """Publish no longer; the session forgets it."""
        self._publisher.undeclare()

    @property
    def has_listener(self) -> bool:
        """Somebody subscribes; encoding for no one can be skipped."""
        status: Any = self._publisher.matching_status  # the stub says bool, it is an object
        return bool(status.matching)


class LatestSubscriber(Inbox[M]):
    """The newest `capacity` messages of a topic; parts may be '*'."""

    def __init__(
        self,
        node: Endpoint,
        topic: Topic,
        message_type: type[M],
        *,
        capacity: int = 3,
        name: str | None = None,
        **parts: str,
    ) -> None:
        super().__init__(message_type, topic=topic, name=name, capacity=capacity, counters=node.counters, log=node.log)
        self._subscriber: Any = node.session.declare_subscriber(
            topic.key(node.line, **parts), zenoh.handlers.Callback(self.push, indirect=False)
        )

    def leave(self) -> None:
        """Listen no longer; what came stays."""
        self._subscriber.undeclare()
