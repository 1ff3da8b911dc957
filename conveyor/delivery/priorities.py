"""The topic table's priorities in Zenoh's terms."""

from __future__ import annotations

import zenoh

from conveyor.topics import Priority, Topic

_ZENOH = {
    Priority.REAL_TIME: zenoh.Priority.REAL_TIME,
    Priority.INTERACTIVE_HIGH: zenoh.Priority.INTERACTIVE_HIGH,
    Priority.DATA_HIGH: zenoh.Priority.DATA_HIGH,
    Priority.DATA: zenoh.Priority.DATA,
    Priority.DATA_LOW: zenoh.Priority.DATA_LOW,
}


def zenoh_priority(topic: Topic) -> zenoh.Priority:
    """Zenoh's priority for messages of `topic`."""
    return _ZENOH[topic.priority]
