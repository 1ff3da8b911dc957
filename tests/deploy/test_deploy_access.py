"""Over TLS with access rules: intruders and forgers reach no one, and every delivery class works for the honest."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zenoh

import viewer.node as viewer_node
from conveyor import topics
from conveyor.access import router_access
from conveyor.config import LinkConfig
from conveyor.delivery import (
    KeptPublisher,
    KeptSubscriber,
    LatestPublisher,
    LatestSubscriber,
    Presence,
    ReliablePublisher,
    ReliableSubscriber,
)
from conveyor.errors import LinkError
from conveyor.geometry import Intrinsics
from conveyor.identity import Identity
from conveyor.messages import Committed, Counters, Frame, FrameProgress, Totals, TrackEntry, Weight
from conveyor.messages.base import Message
from conveyor.session import open_client, open_router
from tests.conftest import wait_until
from tests.deploy.deploy_site import Peer, Site, make_certs, running_site, site_config
from tuberline.certs import issue
from viewer.scene.profiles import PROFILES

pytestmark = pytest.mark.graph

FRAME = Frame(
    camera="rear",
    run="r1",
    seq=0,
    captured_ns=1,
    travel_m=None,
    depth_scale_m=0.001,
    intrinsics=Intrinsics(width=8, height=6, fx=5.0, fy=5.0, cx=4.0, cy=3.0),
    belt_distance_m=0.4,
    depth=np.full((6, 8), 400, np.uint16),
)
WEIGHT = Weight("v/0", "v", "front", "r1", 0, "weighed", 100.0, 90.0, 110.0, "pointraft", "m", (), regressor="honest")
TOTALS = Totals("honest", 1, 100.0, 90.0, 110.0, 1.0, 100.0, 90.0, 110.0, 1.0, 50.0, (0, 1), {}, final=False)
TRACK = TrackEntry("front", "honest", 1)
COUNTERS = Counters("camera", "rear", "honest", 1, "host", "1", 1.0, {}, {})

FORGERIES: dict[str, tuple[str, str, str, topics.Topic, dict[str, str], Message, Message]] = {
    # what: (forger, honest sender, listener, topic, parts, honest message, forged message)
    "a camera another camera's frame": (
        *("camera/front", "camera/rear", "segmenter/rear", topics.FRAME, {"camera": "rear"}),
        *(FRAME, replace(FRAME, run="forged")),
    ),
    "a camera a weight": (
        *("camera/front", "regressor/r1", "segmenter/front", topics.WEIGHT, {"camera": "front"}),
        *(WEIGHT, replace(WEIGHT, regressor="forged")),
    ),
    "a segmenter another's track": (
        *("segmenter/rear", "segmenter/front", "aggregator", topics.TRACK, {"camera": "front"}),
        *(TRACK, replace(TRACK, run="forged")),
    ),
    "a viewer the totals": (
        *("viewer", "aggregator", "observer", topics.TOTALS, {}),
        *(TOTALS, replace(TOTALS, run="forged")),
    ),
    "a viewer another node's counters": (
        *("viewer", "camera/rear", "aggregator", topics.COUNTERS, {"role": "camera", "name": "rear"}),
        *(COUNTERS, replace(COUNTERS, run="forged")),
    ),
    "an operator an acknowledgement": (
        *("observer", "aggregator", "segmenter/front", topics.COMMITTED, {"camera": "front"}),
        *(Committed("front", "honest", 1), Committed("front", "forged", 9)),
    ),
}


def heard_after_forgery(site: Site, what: str) -> set[str]:
    """Who the listener believes to have heard: {'honest'} or more."""
    forger, sender, listener, topic, parts, honest, forged = FORGERIES[what]
    peers = {name: site.join(name) for name in (forger, sender, listener)}
    key = topic.key(site.config.name, **parts)
    heard: list[bytes] = []
    peers[listener].session.declare_subscriber(key, lambda sample: heard.append(sample.payload.to_bytes()))
    publisher = peers[forger].session.declare_publisher(key)
    wait_until(lambda: publisher.matching_status.matching, what="the forger to see that somebody listens")
    publisher.put(forged.encode())
    # The router takes one session's messages in order: when the fence is through, the forgery has passed or has not.
    fence(site, peers[forger], forger)
    honest_out = peers[sender].session.declare_publisher(key, priority=zenoh.Priority.DATA_LOW)
    wait_until(lambda: honest_out.matching_status.matching, what="the honest sender to see that somebody listens")
    wait_until(lambda: honest_out.put(honest.encode()) or honest.encode() in heard, what="the honest message")
    return {"honest" if data == honest.encode() else "forged" for data in heard}


def fence(site: Site, peer: Peer, node: str) -> None:
    """Wait until the router has worked off what this session sent: something it may send comes out at the other end."""
    if node == "observer":  # may send nothing; a question of its own goes the same way
        list(peer.session.liveliness().get(topics.ALIVE.key(peer.line, role="*", name="*"), timeout=5.0))
        return
    role, _, name = node.partition("/")
    key = topics.COUNTERS.key(peer.line, role=role, name=name or "any")
    heard: list[bytes] = []
    site.join("observer").session.declare_subscriber(key, lambda sample: heard.append(sample.payload.to_bytes()))
    publisher = peer.session.declare_publisher(key)
    wait_until(lambda: publisher.matching_status.matching, what="a listener to the fence")
    # Put again until heard: a first message may be gone while the router still learns who listens.
    wait_until(lambda: publisher.put(b"fence") or heard, what="the fence")


@pytest.mark.parametrize("what", FORGERIES)
def test_a_forgery_reaches_nobody(site: Site, what: str) -> None:
    assert heard_after_forgery(site, what) == {"honest"}


def test_without_the_rules_the_same_forgery_arrives(site_certs: Path, free_port: int) -> None:
    """The control: what keeps forgeries out above is the rules, not the test."""
    config = site_config(free_port, site_certs)
    config = config.model_copy(update={"access": config.access.model_copy(update={"enabled": False})})
    with running_site(config, site_certs) as site:
        assert heard_after_forgery(site, "a camera a weight") == {"honest", "forged"}


def test_nobody_takes_anothers_token_and_nobody_answers_for_the_aggregator(site: Site) -> None:
    segmenter, camera, worker, aggregator = (
        site.join(node) for node in ("segmenter/front", "camera/front", "regressor/r1", "aggregator")
    )
    presence = Presence(segmenter, "regressor")
    tokens = [
        peer.session.liveliness().declare_token(topics.ALIVE.key("north", role="regressor", name=name))
        for peer, name in ((camera, "r1"), (camera, "r2"), (worker, "r2"), (worker, "r1"))
    ]
    wait_until(lambda: presence.names(), what="the worker's own token")
    query = topics.QUERY_TOTALS.key("north")

    def answer(text: str) -> Callable[[zenoh.Query], None]:
        def reply(asked: zenoh.Query) -> None:
            with asked:
                asked.reply(query, text)

        return reply

    false = camera.session.declare_queryable(query, answer("forged"))
    real = aggregator.session.declare_queryable(query, answer("honest"))
    operator = site.join("observer")

    def answers() -> list[str]:
        replies = operator.session.get(query, timeout=5.0, target=zenoh.QueryTarget.ALL)
        return [reply.ok.payload.to_string() for reply in replies if reply.ok]

    wait_until(answers, what="an answer")
    assert answers() == ["honest"]
    false.undeclare()
    assert list(camera.session.get(query, timeout=5.0)) == [], "a camera has nothing to ask"
    assert presence.names() == {"r1"}
    tokens[-1].undeclare()
    wait_until(lambda: not presence.names(), what="the token to go with its owner")
    real.undeclare()


def test_a_camera_hears_nothing_but_its_own_progress(site: Site) -> None:
    spy, segmenter, aggregator = (site.join(node) for node in ("camera/rear", "segmenter/front", "aggregator"))
    heard: list[str] = []
    for key in ("tuberline/**", "tuberline/north/track/*", "tuberline/north/camera/front/progress"):
        spy.session.declare_subscriber(key, lambda sample: heard.append(str(sample.key_expr)))
    fence(site, spy, "camera/rear")
    own = LatestSubscriber(spy, topics.FRAME_PROGRESS, FrameProgress, camera="rear")
    entries = ReliableSubscriber(aggregator, topics.TRACK, TrackEntry, camera="*")
    # Publishers are held: what the router does not yet know a listener for is asked of their caches again.
    tracks = ReliablePublisher(segmenter, topics.TRACK, camera="front")
    tracks.put(TRACK)
    others = KeptPublisher(segmenter, topics.FRAME_PROGRESS, camera="front")
    others.put(FrameProgress("front", "r1", 1, 4))
    assert entries.get(30.0) == TRACK
    fence(site, segmenter, "segmenter/front")
    progress = KeptPublisher(site.join("segmenter/rear"), topics.FRAME_PROGRESS, camera="rear")
    progress.put(FrameProgress("rear", "r1", 2, 4))
    assert own.get(30.0) == FrameProgress("rear", "r1", 2, 4)
    own_keys = {"tuberline/north/counters/camera/rear", "tuberline/north/camera/rear/progress"}
    assert set(heard) <= own_keys, "what it sent itself, and what it may hear"


def test_every_delivery_class_works_for_the_honest(site: Site) -> None:
    camera, segmenter, worker, aggregator, viewer, operator = (
        site.join(node)
        for node in ("camera/front", "segmenter/front", "regressor/r1", "aggregator", "viewer/office", "observer")
    )
    frames = [LatestSubscriber(peer, topics.FRAME, Frame, camera="front") for peer in (segmenter, viewer)]
    out = LatestPublisher(camera, topics.FRAME, camera="front")
    wait_until(lambda: out.has_listener, what="the camera to see its listeners")
    wait_until(lambda: out.put(replace(FRAME, camera="front")) or all(map(len, frames)), what="a frame at both")
    assert [(got.get(30.0) or FRAME).camera for got in frames] == ["front", "front"]

    early = KeptSubscriber(operator, topics.COUNTERS, Counters, role="*", name="*")
    counters = KeptPublisher(camera, topics.COUNTERS, role="camera", name="front")
    counters.put(replace(COUNTERS, name="front"))
    late = KeptSubscriber(viewer, topics.COUNTERS, Counters, role="*", name="*")
    for kept in (early, late):
        wait_until(lambda kept=kept: len(kept.latest()) == 1, what="the kept counters")
    progress = KeptPublisher(segmenter, topics.FRAME_PROGRESS, camera="front")
    progress.put(FrameProgress("front", "r1", 7, 4))
    joined = KeptSubscriber(camera, topics.FRAME_PROGRESS, FrameProgress, camera="front")
    wait_until(lambda: [p.done_seq for p in joined.latest().values()] == [7], what="kept progress for a late joiner")

    answers = ReliablePublisher(worker, topics.WEIGHT, camera="front")
    for n in range(5):
        answers.put(replace(WEIGHT, seq=n))
    weights = ReliableSubscriber(segmenter, topics.WEIGHT, Weight, camera="front")
    assert [w.seq for w in (weights.get(30.0) for _ in range(5)) if w] == [0, 1, 2, 3, 4]

    presence = Presence(aggregator, "segmenter")
    token = segmenter.session.liveliness().declare_token(topics.ALIVE.key("north", role="segmenter", name="front"))
    wait_until(lambda: presence.names() == {"front"}, what="the token")
    token.undeclare()
    wait_until(lambda: presence.names() == set(), what="the token to go")


def test_nothing_is_lost_over_a_router_restart_with_rules(site_certs: Path, free_port: int) -> None:
    config = site_config(free_port, site_certs)
    router = open_router(config.link, access_control=router_access(config))
    with ExitStack() as stack:
        site = Site(config, site_certs, stack)
        segmenter, aggregator = site.join("segmenter/front"), site.join("aggregator")
        out = ReliablePublisher(segmenter, topics.TRACK, camera="front")
        into = ReliableSubscriber(aggregator, topics.TRACK, TrackEntry, camera="*")
        got: list[int] = []
        for n in range(1, 31):
            if n == 10:
                router.close()
            if n == 20:
                router = open_router(config.link, access_control=router_access(config))
            out.put(replace(TRACK, n=n))
        deadline = time.monotonic() + 20
        while len(got) < 30 and time.monotonic() < deadline:
            entry = into.get(0.2)
            got += [entry.n] if entry else []
        assert got == list(range(1, 31))
        stack.close()
    router.close()


def refused(link: LinkConfig, node: str) -> None:
    with pytest.raises(LinkError, match="no router answered"):
        open_client(link.model_copy(update={"connect_timeout_s": 0.7}), name=node).close()


def test_intruders_do_not_even_connect(site: Site, tmp_path: Path) -> None:
    link = site.config.link
    plain = LinkConfig(router=link.router.replace("tls/", "tcp/"))
    refused(plain, "camera/front")

    foreign = tmp_path / "foreign"
    make_certs(site.config, foreign)
    refused(link.model_copy(update={"certs": foreign}), "camera/front")

    mixed = {"root_ca": site.certs / "ca.pem", "certs": None}
    by_other_ca = {"certificate": foreign / "camera.front.pem", "private_key": foreign / "camera.front.key"}
    refused(link.model_copy(update={**mixed, **by_other_ca}), "camera/front")

    settings = {
        "mode": "client",
        "connect": {"endpoints": [link.router], "timeout_ms": 700},
        "scouting": {"multicast": {"enabled": False}},
        "transport": {"link": {"tls": {"root_ca_certificate": str(site.certs / "ca.pem")}}},
    }
    with pytest.raises(zenoh.ZError):
        zenoh.open(zenoh.Config.from_json5(json.dumps(settings))).close()
    site.join("camera/front")


def test_a_camera_certificate_cannot_play_the_router(site_certs: Path, free_port: int) -> None:
    config = site_config(free_port, site_certs)
    stolen = config.link.model_copy(
        update={
            "certs": None,
            "root_ca": site_certs / "ca.pem",
            "certificate": site_certs / "camera.front.pem",
            "private_key": site_certs / "camera.front.key",
        }
    )
    router = open_router(stolen)
    refused(config.link, "segmenter/front")
    router.close()


def test_a_node_of_another_line_is_nobody_here(site: Site) -> None:
    """One authority for a site with several lines: a certificate still counts for its own line only."""
    issue(site.certs, Identity("camera", "spare"), line="south", renew=True)
    spare = site.config.link.model_copy(
        update={
            "certs": None,
            "root_ca": site.certs / "ca.pem",
            "certificate": site.certs / "camera.spare.pem",
            "private_key": site.certs / "camera.spare.key",
        }
    )
    stranger = site.join("camera/front", config=site.config.model_copy(update={"link": spare}))
    honest = site.join("camera/front")
    out = [LatestPublisher(peer, topics.FRAME, camera="front") for peer in (stranger, honest)]
    frames = LatestSubscriber(site.join("segmenter/front"), topics.FRAME, Frame, camera="front")
    wait_until(lambda: out[1].has_listener, what="the honest camera to see its listener")
    assert not out[0].has_listener
    out[0].put(replace(FRAME, run="stranger"))
    out[1].put(FRAME)
    assert frames.get(30.0) is not None
    assert frames.get(0.0) is None


def test_a_viewer_whom_no_rule_names_says_that_it_sees_no_process(
    site: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Its certificate lets it in and no rule gives it anything: the picture stayed empty, and nothing said why."""
    monkeypatch.setattr(viewer_node, "SILENT_S", 2.0)
    certs = tmp_path / "certs"
    shutil.copytree(site.certs, certs)
    issue(certs, Identity("viewer", "office"), line=site.config.name)
    link = site.config.link.model_copy(update={"certs": certs})
    config = site.config.model_copy(update={"link": link})
    alive = topics.ALIVE.key(site.config.name, role="aggregator", name="aggregator")
    held = site.join("aggregator/aggregator").session.liveliness().declare_token(alive)

    def said(name: str, *, within_s: float) -> str:
        """What it warned of, in so long."""
        caplog.clear()
        target = viewer_node.Target(rrd=tmp_path / f"{name}.rrd", rrd_limit_bytes=1 << 20, connect=None)
        deadline = time.monotonic() + within_s
        viewer_node.run_viewer(
            config,
            target,
            profile=PROFILES["light"],
            name=name,
            run=None,
            until=lambda: time.monotonic() > deadline or "no process" in caplog.text,
        )
        return caplog.text

    assert "does not name 'office' among its viewers" in said("office", within_s=30.0)
    assert "no process" not in said("viewer", within_s=4.0)
    held.undeclare()
