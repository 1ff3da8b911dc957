"""Stands beside the router of a line and notes when frames pass; run on the edge host by `benchmarks.link_watchers`.

    python -m benchmarks.link_probe LINE.toml

Joins as a viewer, with a viewer's certificate where there are any. Writes one JSON line a fifth of a second: frames
that have passed, tokens that are there. On SIGTERM a last one with every frame's moment and all nodes' counters.
"""

from __future__ import annotations

import json
import logging
import sys
import threading
import time
from pathlib import Path
from typing import Any

import zenoh

from conveyor import topics
from conveyor.config import load_config
from conveyor.counters import CounterSet
from conveyor.delivery.kept import KeptSubscriber
from conveyor.delivery.presence import Presence
from conveyor.messages import Counters
from conveyor.session import open_client
from conveyor.signals import stop_when_told

EVERY_S = 0.2


class Watch:
    """A session of its own on the line: what the delivery classes need, and when frames came by."""

    def __init__(self, session: zenoh.Session, line: str) -> None:
        self.session = session
        self.line = line
        self.counters = CounterSet()
        self.log = logging.getLogger("probe")
        self.passed_s: dict[str, list[float]] = {}

    def frame(self, sample: zenoh.Sample) -> None:
        """A frame on its way; not read, only timed by the monotonic clock."""
        camera = topics.FRAME.parts(str(sample.key_expr))["camera"]
        self.passed_s.setdefault(camera, []).append(time.monotonic())


def main(config: str) -> None:
    """Watch the line of `config` until SIGTERM."""
    stop = threading.Event()
    stop_when_told(stop)
    line = load_config(Path(config))
    with open_client(line.link, name="viewer/probe") as session:
        watch = Watch(session, line.name)
        counters = KeptSubscriber(watch, topics.COUNTERS, Counters, role="*", name="*")
        presence = {role: Presence(watch, role) for role in topics.ALIVE.senders}
        frames: Any = session.declare_subscriber(
            topics.FRAME.key(line.name, camera="*"), zenoh.handlers.Callback(watch.frame, indirect=False)
        )
        while not stop.wait(EVERY_S):
            alive = sorted(f"{role}/{name}" for role, tokens in presence.items() for name in tokens.names())
            _say({"frames": sum(map(len, watch.passed_s.values())), "alive": alive})
        nodes = {f"{c.role}/{c.name}": {**c.gauges, **c.values} for c in counters.latest().values()}
        frames.undeclare()
        _say({"passed_s": watch.passed_s, "nodes": nodes, "last": True})


def _say(message: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(message) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1])
