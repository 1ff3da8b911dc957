"""Messages that were refused, counted by reason and by sender, and told without a flood.

A sender is the place that its key names ('front' of `track/front`): what access control lets it send on, and what a
person can find. Keys from outside may name anything, so only the first few senders are counted by name.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from conveyor.errors import ConfigError, MessageError, Refusal
from conveyor.topics import Topic, check_name

if TYPE_CHECKING:
    from conveyor.counters import CounterSet

MOST_SENDERS = 8
OTHERS = "others"
LOG_EVERY_S = 1.0


class Refusals:
    """Counters `<name>_refused`, `<name>_refused_<reason>` and `<name>_refused_from_<sender>`.

    Args:
        topic: what came; `name` begins the counters' names.
        counters, log: where they go; the log gets one line a second for each reason at most.
        clock: seconds, monotonic.
    """

    def __init__(
        self,
        topic: Topic,
        *,
        name: str,
        counters: CounterSet,
        log: logging.Logger,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._topic = topic
        self._name = name
        self._counters = counters
        self._log = log
        self._clock = clock
        self._lock = threading.Lock()
        self._senders: set[str] = set()
        self._told_s: dict[Refusal, float] = {}
        self._untold: dict[Refusal, int] = {}
        counters.add(f"{name}_refused", 0)

    def refuse(self, key: str, error: MessageError) -> None:
        """Count a message that came on `key` and could not be read."""
        sender = self._sender(key)
        self._counters.add(f"{self._name}_refused")
        self._counters.add(f"{self._name}_refused_{error.reason}")
        self._counters.add(f"{self._name}_refused_from_{sender}")
        with self._lock:
            now_s = self._clock()
            if now_s - self._told_s.get(error.reason, -LOG_EVERY_S) < LOG_EVERY_S:
                self._untold[error.reason] = self._untold.get(error.reason, 0) + 1
                return
            self._told_s[error.reason] = now_s
            more = self._untold.pop(error.reason, 0)
        self._log.error(
            "refused a message from %s on %s (%s): %s%s",
            sender,
            self._name,
            error.reason,
            error,
            f"; {more} more refused for this reason since the last line" if more else "",
        )

    def _sender(self, key: str) -> str:
        sender = sender_of(key, self._topic)
        with self._lock:
            if sender in self._senders:
                return sender
            if sender == OTHERS or len(self._senders) >= MOST_SENDERS:
                return OTHERS
            self._senders.add(sender)
            return sender


def sender_of(key: str, topic: Topic) -> str:
    """Who sends on `key`, as far as it says: the names in it, else the role that sends on this topic."""
    try:
        names = [check_name(name, what=part) for part, name in topic.parts(key).items()]
    except ConfigError:
        return OTHERS
    return ".".join(names) or (topic.senders[0] if topic.senders else OTHERS)
