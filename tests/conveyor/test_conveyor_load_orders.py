"""An order is about the moment at which it was given, though its router came later."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from conveyor.config import LinkConfig
from conveyor.load_orders import give_order
from conveyor.messages import LoadAnswer, LoadOrder
from tests.conftest import start_router
from tests.load_orders import orders_heard

pytestmark = [pytest.mark.graph, pytest.mark.timeout(120)]


def test_the_time_until_the_router_is_there_is_part_of_the_orders_age(free_port: int) -> None:
    """While a killed router came back the belt ran on, and the load began where it was by then."""
    link = LinkConfig(router=f"tcp/127.0.0.1:{free_port}", connect_timeout_s=60)
    given = threading.Event()

    def give() -> tuple[float, LoadAnswer]:
        given.set()
        return time.monotonic(), give_order(link, "line", LoadOrder("a", "start", by="gate"), within_s=60)

    with ThreadPoolExecutor(1) as pool:
        begun = pool.submit(give)
        assert given.wait(60)
        before_s = time.monotonic()
        router = start_router(link.router)
        came_s = time.monotonic() - before_s
        with orders_heard(link) as heard:
            began_s, answer = begun.result(timeout=90)
    router.terminate()
    router.wait(30)
    assert answer.done
    heard_s, order = heard[-1]
    assert heard_s - began_s - order.age_s < came_s / 2, "the time until the router came is missing"
