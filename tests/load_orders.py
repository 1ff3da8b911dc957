"""An aggregator that takes every order about a load and answers it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

import zenoh

from conveyor import topics
from conveyor.config import LineConfig, LinkConfig
from conveyor.messages import LoadAnswer, LoadOrder
from conveyor.node import Node


@contextmanager
def orders_heard(link: LinkConfig) -> Iterator[list[tuple[float, LoadOrder]]]:
    """Orders to the line `line` on `link`, each with the monotonic second at which it came."""
    heard: list[tuple[float, LoadOrder]] = []

    def hear(query: zenoh.Query) -> None:
        assert query.payload is not None
        order = LoadOrder.decode(query.payload.to_bytes())
        heard.append((time.monotonic(), order))
        with query:
            query.reply(topics.ORDER_LOAD.key("line"), LoadAnswer(order.request, True).encode())

    with Node("aggregator", "aggregator", config=LineConfig(link=link), run="r1") as node:
        queryable = node.session.declare_queryable(
            topics.ORDER_LOAD.key("line"), zenoh.handlers.Callback(hear, indirect=True)
        )
        yield heard
        queryable.undeclare()
