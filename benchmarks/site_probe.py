"""Stands beside the router and notes when views and weights pass. Run on the edge host by `benchmarks.site`.

Writes one JSON line a fifth of a second: what has passed and who is alive. On SIGTERM a last one with everything.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from typing import Any

import zenoh

from conveyor import topics
from conveyor.config import LinkConfig
from conveyor.messages import View, Weight
from conveyor.observer import Observer
from conveyor.signals import stop_when_told

EVERY_S = 0.2


class Passing:
    """Moments at which views and weights came by, seconds of the monotonic clock."""

    def __init__(self) -> None:
        self.view_s: dict[str, float] = {}
        self.weights: list[tuple[str, str, float]] = []

    def view(self, sample: zenoh.Sample) -> None:
        """A view on its way to a regressor; one that is sent again counts from its last sending."""
        self.view_s[View.decode(sample.payload.to_bytes()).view_id] = time.monotonic()

    def weight(self, sample: zenoh.Sample) -> None:
        """A regressor's answer."""
        weight = Weight.decode(sample.payload.to_bytes())
        self.weights.append((weight.view_id, weight.regressor, time.monotonic()))

    def report(self) -> list[dict[str, Any]]:
        """Every weight with its moment and how long its view took, in the order they came."""
        return [
            {"regressor": regressor, "at_s": at_s, "took_s": at_s - self.view_s.get(view_id, at_s)}
            for view_id, regressor, at_s in self.weights
        ]


def main(router: str, line: str) -> None:
    """Watch `line` at `router` until SIGTERM."""
    stop = threading.Event()
    stop_when_told(stop)
    passing = Passing()
    with Observer(LinkConfig(router=router), line=line) as observer:
        session = observer.session
        view_key = topics.VIEW.key(line, regressor="*")
        weight_key = topics.WEIGHT.key(line, camera="*")
        watching = [
            session.declare_subscriber(view_key, zenoh.handlers.Callback(passing.view, indirect=False)),
            session.declare_subscriber(weight_key, zenoh.handlers.Callback(passing.weight, indirect=False)),
        ]
        while not stop.wait(EVERY_S):
            _say({"weights": len(passing.weights), "alive": sorted(observer.alive())})
        nodes = {name: {**c.gauges, **c.values} for name, c in observer.nodes().items()}
        del watching
        _say({"passed": passing.report(), "nodes": nodes, "last": True})


def _say(message: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(message) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
