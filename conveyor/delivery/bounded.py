"""Values by key, so many at most: keys come from outside, and who can send could send new ones forever.

Who stands in the line's config, and who proves to be alive, is kept before others; among equals the first one stays.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Generic, TypeVar

from conveyor.errors import ConfigError
from conveyor.topics import Topic, check_name

MOST_KEYS = 1024
"""Of one subscription. A large site has some hundred processes; a report takes up to some 80 kB."""
CONFIGURED, ALIVE, UNKNOWN = 2, 1, 0

V = TypeVar("V")


class Bounded(Generic[V]):
    """At most `most` values; not thread-safe.

    Args:
        rank: of a key, higher is kept before lower; asked again each time, since who is alive changes.
    """

    def __init__(self, *, most: int = MOST_KEYS, rank: Callable[[str], int] = lambda _: UNKNOWN) -> None:
        self._most = most
        self._rank = rank
        self._values: dict[str, V] = {}

    def __len__(self) -> int:
        return len(self._values)

    def __contains__(self, key: object) -> bool:
        return key in self._values

    def put(self, key: str, value: V) -> bool:
        """Keep `value`; False where there is no room and none of a lower rank to make some."""
        if key not in self._values and len(self._values) >= self._most and not self._make_room(self._rank(key)):
            return False
        self._values[key] = value
        return True

    def discard(self, key: str) -> None:
        """Forget `key`, if it is there."""
        self._values.pop(key, None)

    def all(self) -> dict[str, V]:
        """Everything by key, in the order in which keys came."""
        return dict(self._values)

    def _make_room(self, rank: int) -> bool:
        if rank == UNKNOWN:
            return False
        lowest = min(self._values, key=self._rank)
        if self._rank(lowest) >= rank:
            return False
        del self._values[lowest]
        return True


def node_of(topic: Topic, key: str) -> str | None:
    """'role/name' of the node that a key of `topic` belongs to; '' for a key without names, None for a forged name."""
    try:
        parts = {part: check_name(name, what=part) for part, name in topic.parts(key).items()}
    except ConfigError:
        return None
    if not parts:
        return ""
    role = parts.get("role") or (topic.senders[0] if topic.senders else "")
    return f"{role}/{list(parts.values())[-1]}"


def ranks(
    topic: Topic, *, known: Collection[str] = (), alive: Callable[[str], bool] = lambda _: False
) -> Callable[[str], int]:
    """The rank of a key of `topic`: its node stands in `known` ('role/name'), or is `alive`, or neither."""

    def rank(key: str) -> int:
        node = node_of(topic, key)
        if node is None:
            return UNKNOWN
        return CONFIGURED if node in known else ALIVE if alive(node) else UNKNOWN

    return rank
