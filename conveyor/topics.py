"""The table of topics: the only place that knows them.

Publishers, subscribers, the recorder, health, access control and `docs/topics.md` are all made from it. A key is
`tuberline/<line>/<path>`; `<...>` parts of a path are filled by name.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum

from conveyor.errors import ConfigError

ROOT = "tuberline"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")


class Delivery(StrEnum):
    """What a topic promises. Each class is implemented once, in `conveyor.delivery`."""

    LATEST = "latest wins"
    KEPT = "kept"
    NEVER_LOST = "never lost"
    DISPATCHED = "dispatched"
    TOKEN = "liveliness token"
    QUERY = "query"

    @property
    def promise(self) -> str:
        """What it is, for docs/topics.md."""
        return _PROMISES[self]


_PROMISES = {
    Delivery.LATEST: "dropped on a full link, overwritten in a small ring at the receiver; gaps show in the numbers",
    Delivery.KEPT: "the newest value of each key; who joins later gets it too",
    Delivery.NEVER_LOST: "all, in order, after a cut link too, from a sender that lives and still has them",
    Delivery.DISPATCHED: "to one receiver, which the sender chooses; to another one where no answer comes in time",
    Delivery.TOKEN: "no message: there while a process and its link live",
    Delivery.QUERY: "a question, which the receiver answers",
}


class Priority(StrEnum):
    """Which message goes first on a full link. Names follow Zenoh's own priorities."""

    REAL_TIME = "real_time"
    INTERACTIVE_HIGH = "interactive_high"
    DATA_HIGH = "data_high"
    DATA = "data"
    DATA_LOW = "data_low"


TRANSMIT_BATCHES: dict[Priority, int] = {
    Priority.REAL_TIME: 2,
    Priority.INTERACTIVE_HIGH: 4,
    Priority.DATA_HIGH: 16,
    Priority.DATA: 16,
    Priority.DATA_LOW: 16,
}
"""Batches of 64 kB that may wait for a link, per priority; Zenoh's upper bound is 16.

Of a message that does not fit, Zenoh drops the rest without a word. With its default of 2 (128 kB) no frame of 400 kB
ever passed a link of 2 Mbit/s, and a burst of views on loopback lost 1 to 21 of them, each of which held up the ledger
until its deadline of 5 s (8 of 8 runs; with 16 none in 5). Tokens and acknowledgements are a few bytes each.
"""


@dataclass(frozen=True, slots=True)
class Topic:
    """One row: where it lives, who sends, who listens, what is promised."""

    name: str
    path: str
    senders: tuple[str, ...]
    receivers: tuple[str, ...]
    delivery: Delivery
    priority: Priority
    message: str
    """Name of the message class in `conveyor.messages`; empty for tokens and queries."""
    about: str

    @property
    def part_names(self) -> tuple[str, ...]:
        """Names of the `<...>` parts of its path."""
        return tuple(re.findall("<(.*?)>", self.path))

    def key(self, line: str, **parts: str) -> str:
        """Key expression of this topic on `line`; each `<part>` of the path must be given (or be '*')."""
        path = self.path
        for part, value in parts.items():
            if value != "*":
                check_name(value, what=part)
            path = path.replace(f"<{part}>", value)
        if "<" in path:
            raise ConfigError(f"topic '{self.name}' needs {re.findall('<(.*?)>', path)}, got {sorted(parts)}")
        return f"{ROOT}/{check_name(line, what='line')}/{path}"

    def parts(self, key: str) -> dict[str, str]:
        """The named parts of a concrete key, e.g. {'camera': 'front'}."""
        pattern = re.sub(r"<(\w+)>", r"(?P<\1>[^/]+)", self.path)
        match = re.fullmatch(rf"{ROOT}/[^/]+/{pattern}", key)
        if match is None:
            raise ConfigError(f"key '{key}' is not of topic '{self.name}' ({self.path})")
        return match.groupdict()


def check_name(name: str, *, what: str) -> str:
    """Names become parts of keys, file names and unit names: letters, digits, '.', '_' and '-', at most 64."""
    if not _NAME.fullmatch(name):
        raise ConfigError(
            f"{what} name '{name}' cannot be used: 1 to 64 letters (a to z, A to Z), digits, '.', '_' or '-', starting "
            "with a letter or digit, such as 'front-2'"
        )
    return name


FRAME = Topic(
    "frame",
    "camera/<camera>/frame",
    ("camera",),
    ("segmenter", "viewer", "recorder"),
    Delivery.LATEST,
    Priority.DATA_LOW,
    "Frame",
    "one depth image with everything needed to read it",
)
FRAME_FEW = Topic(
    "frame_few",
    "camera/<camera>/frame_few",
    ("camera",),
    ("viewer",),
    Delivery.LATEST,
    Priority.DATA_LOW,
    "Frame",
    "the first frame of each fifth of a second, for those who show no more",
)
FEW_PER_S = 5
"""Of capture time."""
FRAME_SLOT = Topic(
    "frame_slot",
    "camera/<camera>/frame_slot",
    ("camera",),
    ("segmenter",),
    Delivery.LATEST,
    Priority.DATA_LOW,
    "FrameSlot",
    "where in their shared memory a frame lies",
)
"""Of the direct link between a camera and its segmenter alone: not in `TOPICS`, so that no router lets it pass."""
CAMERA_INFO = Topic(
    "camera_info",
    "camera/<camera>/info",
    ("camera",),
    ("segmenter", "aggregator", "viewer", "recorder", "gnss", "operator"),
    Delivery.KEPT,
    Priority.DATA_HIGH,
    "CameraInfo",
    "what the camera is, how far it got, whether it ended",
)
FRAME_PROGRESS = Topic(
    "frame_progress",
    "camera/<camera>/progress",
    ("segmenter",),
    ("camera", "encoder"),
    Delivery.KEPT,
    Priority.INTERACTIVE_HIGH,
    "FrameProgress",
    "how far the segmenter got; a replay that must not lose frames waits for it",
)
PICTURE = Topic(
    "picture",
    "picture/<camera>",
    ("segmenter",),
    ("operator",),
    Delivery.LATEST,
    Priority.DATA_LOW,
    "Picture",
    "what a camera sees, for people: small, a few a second, only while somebody looks",
)
TRAVEL = Topic(
    "travel",
    "belt/travel/<source>",
    ("encoder", "segmenter"),
    ("camera", "encoder", "aggregator", "viewer", "operator"),
    Delivery.LATEST,
    Priority.DATA_HIGH,
    "Travel",
    "how far the belt has moved",
)
VIEW = Topic(
    "view",
    "work/<regressor>/view",
    ("segmenter",),
    ("regressor", "viewer"),
    Delivery.DISPATCHED,
    Priority.DATA,
    "View",
    "one tuber in one frame, to be weighed",
)
WEIGHT = Topic(
    "weight",
    "weight/<camera>",
    ("regressor",),
    ("segmenter", "viewer"),
    Delivery.NEVER_LOST,
    Priority.DATA_HIGH,
    "Weight",
    "the answer to a view, and its receipt",
)
TRACK = Topic(
    "track",
    "track/<camera>",
    ("segmenter",),
    ("aggregator", "viewer"),
    Delivery.NEVER_LOST,
    Priority.DATA_HIGH,
    "TrackEntry",
    "the camera's log: finished tracks with their weighed views, and marks of how far it has seen",
)
IN_VIEW = Topic(
    "in_view",
    "in_view/<camera>",
    ("segmenter",),
    ("viewer",),
    Delivery.LATEST,
    Priority.DATA_LOW,
    "TracksInView",
    "what a camera has in view, with weights so far; sent while a viewer listens",
)
COMMITTED = Topic(
    "committed",
    "committed/<camera>",
    ("aggregator",),
    ("segmenter",),
    Delivery.KEPT,
    Priority.INTERACTIVE_HIGH,
    "Committed",
    "up to which entry the camera's log is durable in the ledger",
)
TUBER = Topic(
    "tuber",
    "tuber",
    ("aggregator",),
    ("viewer",),
    Delivery.NEVER_LOST,
    Priority.DATA_HIGH,
    "Tuber",
    "one counted tuber, published after its commit",
)
TOTALS = Topic(
    "totals",
    "totals",
    ("aggregator",),
    ("viewer", "operator"),
    Delivery.KEPT,
    Priority.DATA_HIGH,
    "Totals",
    "what the load weighs so far, and how much of the belt was seen",
)
POSITION = Topic(
    "position",
    "position/<receiver>",
    ("gnss",),
    ("viewer", "recorder", "operator"),
    Delivery.NEVER_LOST,
    Priority.DATA_HIGH,
    "Position",
    "where the machine is, by its GNSS receiver, or by that of the recording that is replayed",
)
COUNTERS = Topic(
    "counters",
    "counters/<role>/<name>",
    ("camera", "segmenter", "regressor", "aggregator", "viewer", "recorder", "gnss", "encoder"),
    ("aggregator", "viewer", "operator"),
    Delivery.KEPT,
    Priority.DATA_HIGH,
    "Counters",
    "what a node received, did and dropped, once a second",
)
ALIVE = Topic(
    "alive",
    "alive/<role>/<name>",
    ("camera", "segmenter", "regressor", "aggregator", "viewer", "recorder", "gnss", "encoder"),
    ("segmenter", "regressor", "aggregator", "viewer", "operator"),
    Delivery.TOKEN,
    Priority.REAL_TIME,
    "",
    "the node's process and link are alive",
)
QUERY_TOTALS = Topic(
    "query_totals",
    "query/totals",
    ("aggregator",),
    ("operator", "viewer"),
    Delivery.QUERY,
    Priority.DATA_HIGH,
    "",
    "answers the totals as JSON",
)
QUERY_TUBERS = Topic(
    "query_tubers",
    "query/tubers",
    ("aggregator",),
    ("operator", "viewer"),
    Delivery.QUERY,
    Priority.DATA_HIGH,
    "",
    "answers committed tubers as JSON; parameters: since, limit",
)
QUERY_LOADS = Topic(
    "query_loads",
    "query/loads",
    ("aggregator",),
    ("operator", "viewer"),
    Delivery.QUERY,
    Priority.DATA_HIGH,
    "",
    "answers the ledger's last runs as JSON, its loads with what=loads, the run's tubers by weights with what=models; "
    "parameters: limit, what, load (number or name)",
)

QUERY_MODEL = Topic(
    "query_model",
    "query/model/<regressor>",
    ("regressor",),
    ("regressor", "operator", "keeper"),
    Delivery.QUERY,
    Priority.DATA_LOW,
    "",
    "answers which weights it weighs with, and their bytes; parameters: do=state, do=piece, digest, offset",
)
ORDER_MODEL = Topic(
    "order_model",
    "order/model/<regressor>",
    ("regressor",),
    ("keeper",),
    Delivery.QUERY,
    Priority.DATA_LOW,
    "",
    "takes new weights, checks them and changes over; parameters: do=piece, do=check, do=take, digest, offset, size, n",
)
ORDER_LOAD = Topic(
    "order_load",
    "order/load",
    ("aggregator",),
    ("loader",),
    Delivery.QUERY,
    Priority.INTERACTIVE_HIGH,
    "",
    "takes a LoadOrder: starts, ends, notes, weighs or undoes a load; answers a LoadAnswer when it is durable",
)

TOPICS: tuple[Topic, ...] = (
    FRAME,
    FRAME_FEW,
    CAMERA_INFO,
    FRAME_PROGRESS,
    PICTURE,
    TRAVEL,
    VIEW,
    WEIGHT,
    TRACK,
    IN_VIEW,
    COMMITTED,
    TUBER,
    TOTALS,
    POSITION,
    COUNTERS,
    ALIVE,
    QUERY_TOTALS,
    QUERY_TUBERS,
    QUERY_LOADS,
    QUERY_MODEL,
    ORDER_MODEL,
    ORDER_LOAD,
)
