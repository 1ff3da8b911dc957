"""`tuberline load`: about the moment at which it was typed; where no router is there yet it waits, and says so."""

from __future__ import annotations

import time

import pytest
import zenoh

from conveyor import topics
from conveyor.config import LineConfig, LinkConfig
from conveyor.errors import PASSING
from conveyor.messages import LoadAnswer, LoadOrder
from conveyor.node import Node
from tests.belts import tuberline


def test_an_order_says_that_it_waits_and_how_long(free_port: int) -> None:
    """It gave up after 5 s whatever --wait-s said: the line was just starting."""
    router = f"tcp/127.0.0.1:{free_port}"
    done = tuberline("load", "start", "A", "--connect", router, "--wait-s", "7", check=False)
    waits, ended = done.stderr.splitlines()
    assert waits.startswith(f"tuberline: no answer by {router} yet; asking for 7 s. The order is about the moment")
    assert ended.startswith(f"tuberline: no router answered at {router} within 7 s; start the line")
    assert done.returncode == PASSING


@pytest.mark.graph
def test_an_order_is_about_the_moment_at_which_it_was_typed(link: LinkConfig) -> None:
    """Python took 1 s to start, and 9 s on a machine where a whole line was starting, too: so late the load began."""
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
        typed_s = time.monotonic()
        tuberline("load", "start", "A", "--connect", link.router)
        queryable.undeclare()
    heard_s, order = heard[-1]
    assert heard_s - typed_s - order.age_s < (heard_s - typed_s) / 2
