"""Who may start and end loads: the rules made from the topic table, on real sessions with certificates."""

from __future__ import annotations

import pytest
import zenoh

from conveyor.errors import LinkError
from conveyor.load_orders import send_order
from conveyor.messages import LoadAnswer, LoadOrder
from conveyor.topics import ORDER_LOAD
from tests.deploy.deploy_site import Site

pytestmark = pytest.mark.graph


def test_a_loader_may_an_operator_and_a_camera_may_not(site: Site) -> None:
    """The page, a sensor at the trailer and the command ask with a loader's certificate."""
    aggregator = site.join("aggregator/aggregator")
    taken: list[str] = []

    def take(query: zenoh.Query) -> None:
        with query:
            assert query.payload is not None
            order = LoadOrder.decode(query.payload.to_bytes())
            taken.append(order.by)
            query.reply(key, LoadAnswer(order.request, True, text="done").encode())

    key = ORDER_LOAD.key(aggregator.line)
    held = aggregator.session.declare_queryable(key, zenoh.handlers.Callback(take, indirect=True))
    loader, operator, camera = site.join("loader"), site.join("observer"), site.join("camera/front")
    assert send_order(loader.session, site.config.name, LoadOrder("a", "start", by="gate")).done
    for name, intruder in (("operator", operator), ("camera", camera)):
        with pytest.raises(LinkError, match=r"may this certificate change loads \(access.loaders\)"):
            send_order(intruder.session, site.config.name, LoadOrder("b", "end", by=name), within_s=1.5)
    assert set(taken) == {"gate"}
    held.undeclare()
