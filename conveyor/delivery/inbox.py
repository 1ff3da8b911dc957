"""A bounded queue between Zenoh's receiving thread and the thread that works.

Zenoh's own FIFO handler starves every other subscriber of the session once it is full, and its ring does not count what
it overwrites; this one never blocks the receiving thread and counts every loss.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Generic, TypeVar

from conveyor.delivery.refusals import Refusals
from conveyor.errors import MessageError
from conveyor.messages import Message
from conveyor.topics import Topic

if TYPE_CHECKING:
    import zenoh

    from conveyor.counters import CounterSet

M = TypeVar("M", bound=Message)


class Inbox(Generic[M]):
    """Newest `capacity` messages, oldest first. What does not fit pushes the oldest out and is counted.

    `on_refused` gets key, bytes and error of what cannot be decoded, in the thread that reads, after it was counted.
    """

    def __init__(
        self,
        message_type: type[M],
        *,
        topic: Topic,
        name: str | None = None,
        capacity: int,
        counters: CounterSet,
        log: logging.Logger,
        on_refused: Callable[[str, bytes, MessageError], None] | None = None,
    ) -> None:
        self._type = message_type
        self._name = name = name or topic.name
        self._counters = counters
        self._refusals = Refusals(topic, name=name, counters=counters, log=log)
        self._log = log
        self._capacity = capacity
        self._on_refused = on_refused
        self._queue: deque[tuple[str, bytes, int]] = deque()
        self._arrived = threading.Condition()
        for outcome in ("received", "dropped_overwritten"):
            counters.add(f"{name}_{outcome}", 0)

    def push(self, sample: zenoh.Sample) -> None:
        """Zenoh's callback; runs on its receiving thread, so it only copies and queues."""
        self.push_data(str(sample.key_expr), sample.payload.to_bytes())

    def push_data(self, key: str, data: bytes) -> None:
        """Queue an encoded message that came on `key`."""
        item = (key, data, time.monotonic_ns())
        with self._arrived:
            overwritten = len(self._queue) >= self._capacity
            if overwritten:
                self._queue.popleft()
            self._queue.append(item)
            self._arrived.notify()
        self._counters.add(f"{self._name}_received")
        if overwritten:
            self._counters.add(f"{self._name}_dropped_overwritten")

    def missed(self) -> None:
        """A message came and was overwritten before it could be queued."""
        self._counters.add(f"{self._name}_received")
        self._counters.add(f"{self._name}_dropped_overwritten")

    def get(self, timeout_s: float) -> M | None:
        """The oldest message, waiting up to `timeout_s`; None if none came. Refused ones are counted and logged."""
        item = self.get_with_key(timeout_s)
        return item[1] if item else None

    def get_with_key(self, timeout_s: float) -> tuple[str, M] | None:
        """Like `get`, with the key the message came on."""
        item = self._take(timeout_s)
        return None if item is None else item[:2]

    def get_with_arrival(self, timeout_s: float) -> tuple[M, int] | None:
        """Like `get`, with the time at which it came: monotonic, nanoseconds."""
        item = self._take(timeout_s)
        return None if item is None else item[1:]

    def _take(self, timeout_s: float) -> tuple[str, M, int] | None:
        deadline = time.monotonic() + timeout_s
        while True:
            with self._arrived:
                while not self._queue:
                    left = deadline - time.monotonic()
                    if left <= 0 or not self._arrived.wait(left):
                        return None
                key, data, arrived_ns = self._queue.popleft()
            try:
                return key, self._type.decode(data), arrived_ns
            except MessageError as error:
                self._refusals.refuse(key, error)
                if self._on_refused is not None:
                    self._on_refused(key, data, error)

    def __len__(self) -> int:
        return len(self._queue)
