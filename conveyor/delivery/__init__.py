"""The delivery classes of the topic table, each implemented once.

Congestion control is DROP everywhere: BLOCK lets one frozen subscriber stall its publisher and all of that publisher's
other subscribers for seconds. What must not be lost is recovered, not waited for.
"""

from conveyor.delivery.inbox import Inbox
from conveyor.delivery.kept import KeptPublisher, KeptSubscriber
from conveyor.delivery.latest import LatestPublisher, LatestSubscriber
from conveyor.delivery.presence import Presence
from conveyor.delivery.reliable import ReliablePublisher, ReliableSubscriber

__all__ = [
    "Inbox",
    "KeptPublisher",
    "KeptSubscriber",
    "LatestPublisher",
    "LatestSubscriber",
    "Presence",
    "ReliablePublisher",
    "ReliableSubscriber",
]
