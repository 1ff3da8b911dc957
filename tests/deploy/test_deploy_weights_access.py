"""Who may give a line new weights: the rules made from the topic table, on real sessions with certificates."""

from __future__ import annotations

import pytest
import zenoh

from conveyor.errors import LinkError
from conveyor.topics import ORDER_MODEL, QUERY_MODEL
from regressor.serve import link as weights_link
from regressor.serve.link import PIECE_BYTES, fetch, send, states
from regressor.serve.messages import WeightsState, digest_of
from tests.conftest import wait_until
from tests.deploy.deploy_site import Peer, Site

pytestmark = pytest.mark.graph

PARCEL = bytes(range(256)) * 500
STATE = WeightsState("r1", "barn", 1, digest_of(PARCEL), "monday@12345678", "", "", "")


def a_regressor(peer: Peer, name: str) -> tuple[list[object], bytearray]:
    """Answers as a regressor does; what it was given."""
    taken = bytearray()

    def tell(query: zenoh.Query) -> None:
        with query:
            offset = int(query.parameters.get("offset") or 0)
            asked = query.parameters.get("do")
            query.reply(key, STATE.encode() if asked == "state" else PARCEL[offset : offset + PIECE_BYTES])

    def take(query: zenoh.Query) -> None:
        with query:
            taken.extend(query.payload.to_bytes() if query.payload else b"")
            query.reply(query.key_expr, str(len(taken)))

    key = QUERY_MODEL.key(peer.line, regressor=name)
    handlers = ((key, tell), (ORDER_MODEL.key(peer.line, regressor=name), take))
    held = [peer.session.declare_queryable(k, zenoh.handlers.Callback(work, indirect=True)) for k, work in handlers]
    return list(held), taken


def test_a_keeper_may_an_operator_and_a_camera_may_not(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(weights_link, "PIECE_ATTEMPTS", 1)
    worker, other = site.join("regressor/r1"), site.join("regressor/r2")
    _held, taken = a_regressor(worker, "r1")
    keeper, operator, camera = site.join("keeper"), site.join("observer"), site.join("camera/front")
    wait_until(lambda: states(keeper.session, site.config.name, timeout_s=2.0) == {"r1": STATE}, what="a state")
    for may_ask in (operator, other):
        assert states(may_ask.session, site.config.name) == {"r1": STATE}
    assert fetch(other.session, site.config.name, STATE, STATE.digest) == PARCEL, "a regressor follows the others"
    assert states(camera.session, site.config.name, timeout_s=0.5) == {}
    for intruder in (operator, other, camera):
        with pytest.raises(LinkError, match=r"does not answer 'piece': has it stopped, or may you not ask"):
            send(intruder.session, site.config.name, "r1", PARCEL)
    assert not taken
    send(keeper.session, site.config.name, "r1", PARCEL)
    assert bytes(taken) == PARCEL
