"""`tuberline load`: about the moment at which it was typed; where no router is there yet it waits, and says so."""

from __future__ import annotations

import time

import pytest

from conveyor.config import LinkConfig
from conveyor.errors import PASSING
from tests.belts import tuberline
from tests.load_orders import orders_heard


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
    with orders_heard(link) as heard:
        typed_s = time.monotonic()
        tuberline("load", "start", "A", "--connect", link.router)
    heard_s, order = heard[-1]
    assert heard_s - typed_s - order.age_s < (heard_s - typed_s) / 2
