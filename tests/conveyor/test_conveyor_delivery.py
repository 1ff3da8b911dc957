"""The delivery classes over a real router: what is promised holds, what is lost is counted."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from conveyor import topics
from conveyor.config import LineConfig, LinkConfig
from conveyor.counters import CounterSet
from conveyor.delivery import (
    KeptPublisher,
    KeptSubscriber,
    LatestPublisher,
    LatestSubscriber,
    Presence,
    ReliablePublisher,
    ReliableSubscriber,
)
from conveyor.delivery.refusals import Refusals
from conveyor.delivery.reliable import CACHE_MESSAGES
from conveyor.errors import LinkError, MessageError, Refusal
from conveyor.messages import Committed, FrameProgress, Travel
from conveyor.node import Node
from conveyor.session import open_client
from tests.conftest import sender_and_receiver, start_router, wait_until

pytestmark = pytest.mark.graph


@pytest.fixture
def node(link: LinkConfig) -> Iterator[Node]:
    with Node("segmenter", "front", config=LineConfig(link=link), run="r1") as node:
        yield node


def travel(n: int) -> Travel:
    return Travel(source="front", run="r1", captured_ns=n, travel_m=n / 10, estimated=False)


def test_latest_wins_counts_what_it_overwrites(node: Node) -> None:
    publisher = LatestPublisher(node, topics.TRAVEL, source="front")
    subscriber = LatestSubscriber(node, topics.TRAVEL, Travel, capacity=2, source="*")
    wait_until(lambda: publisher.has_listener, what="matching")
    for n in range(10):
        publisher.put(travel(n))
    wait_until(lambda: node.counters.get("travel_received") == 10, what="ten messages")
    got = [subscriber.get(1.0), subscriber.get(1.0), subscriber.get(0.01)]
    assert got == [travel(8), travel(9), None]
    assert node.counters.get("travel_dropped_overwritten") == 8


def test_a_foreign_message_is_refused_and_counted_and_the_next_one_taken(node: Node) -> None:
    subscriber = LatestSubscriber(node, topics.TRAVEL, Travel, source="*")
    publisher = LatestPublisher(node, topics.TRAVEL, source="front")
    wait_until(lambda: publisher.has_listener, what="matching")
    node.session.put(topics.TRAVEL.key(node.line, source="other"), b"TBL\x07junk")
    publisher.put(travel(1))
    assert subscriber.get(30.0) == travel(1)
    assert node.counters.get("travel_refused") == 1
    assert node.counters.get("travel_refused_version") == 1
    assert node.counters.get("travel_refused_from_other") == 1


def test_refusals_are_counted_by_reason_and_by_few_senders_and_told_once_a_second() -> None:
    """A sender that forges keys and floods: neither the counters nor the log grow with it."""
    counters, said, now_s = CounterSet(), [], [10.0]
    log = logging.getLogger("refusals")
    log.error = lambda text, *values: said.append(text % values)  # type: ignore[method-assign,assignment]
    refusals = Refusals(topics.TRACK, name="track", counters=counters, log=log, clock=lambda: now_s[0])
    for n in range(1000):
        now_s[0] += 0.003
        reason = Refusal.RANGE if n % 2 else Refusal.KIND
        refusals.refuse(topics.TRACK.key("line", camera=f"c{n % 100}"), MessageError(f"number {n}", reason=reason))
    refusals.refuse("tuberline/line/track/front/more", MessageError("a foreign key"))
    values, _ = counters.snapshot()
    assert values["track_refused"] == 1001
    assert (values["track_refused_range"], values["track_refused_kind"], values["track_refused_content"]) == (
        500,
        500,
        1,
    )
    by_sender = {name: n for name, n in values.items() if "_from_" in name}
    assert by_sender == {**{f"track_refused_from_c{n}": 10 for n in range(8)}, "track_refused_from_others": 921}
    assert len(said) == 2 * 3 + 1  # 3 s, two reasons, and the foreign key
    assert said[0] == "refused a message from c0 on track (kind): number 0"
    more = "166 more refused for this reason since the last line"
    assert said[2] == f"refused a message from others on track (kind): number 334; {more}"


def test_kept_reaches_late_joiners(node: Node) -> None:
    publisher = KeptPublisher(node, topics.FRAME_PROGRESS, camera="front")
    for done in range(5):
        publisher.put(FrameProgress("front", "r1", done, 4))
    late = KeptSubscriber(node, topics.FRAME_PROGRESS, FrameProgress, camera="*")
    wait_until(lambda: bool(late.latest()), what="the kept value")
    assert list(late.latest().values()) == [FrameProgress("front", "r1", 4, 4)]


def test_never_lost_survives_a_killed_router(free_port: int) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port}"
    router = start_router(endpoint)
    with sender_and_receiver(LinkConfig(router=endpoint)) as (sender, receiver):
        out = ReliablePublisher(sender, topics.COMMITTED, camera="front")
        into = ReliableSubscriber(receiver, topics.COMMITTED, Committed, camera="*")
        got: list[int] = []
        for n in range(60):
            if n == 20:
                os.kill(router.pid, signal.SIGKILL)
                router.wait()
            if n == 40:
                router = start_router(endpoint)
            out.put(Committed("front", "r1", n))
            time.sleep(0.005)
        deadline = time.monotonic() + 20
        while len(got) < 60 and time.monotonic() < deadline:
            message = into.get(0.2)
            if message:
                got.append(message.n)
        assert got == list(range(60))
    router.terminate()
    router.wait(30)


def test_what_outgrows_the_senders_cache_is_a_loss_with_a_count(free_port: int) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port}"
    router = start_router(endpoint)
    with sender_and_receiver(LinkConfig(router=endpoint)) as (sender, receiver):
        out = ReliablePublisher(sender, topics.COMMITTED, camera="front")
        into = ReliableSubscriber(receiver, topics.COMMITTED, Committed, camera="*")
        out.put(Committed("front", "r1", 0))
        assert into.get(30.0) == Committed("front", "r1", 0)
        os.kill(router.pid, signal.SIGKILL)
        router.wait()
        newest = CACHE_MESSAGES + 10
        for n in range(1, newest + 1):
            out.put(Committed("front", "r1", n))
        router = start_router(endpoint)
        wait_until(lambda: len(into) == CACHE_MESSAGES, what="everything that the cache still held")
        got = [message.n for message in (into.get(0.0) for _ in range(CACHE_MESSAGES)) if message]
        assert got == list(range(11, newest + 1))
        assert receiver.counters.get("committed_missed") == 10
    router.terminate()
    router.wait(30)


def test_presence_follows_tokens(node: Node) -> None:
    presence = Presence(node, "regressor")
    with Node("regressor", "r1", config=node.config, run="r1", announce=False) as worker:
        assert presence.names() == set()
        worker.announce()
        wait_until(lambda: presence.names() == {"r1"}, what="the token")
    wait_until(lambda: presence.names() == set(), what="the token to go")


def test_presence_asks_for_what_it_was_not_told(node: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two segmenters that stood still for 10 s were told of no token any more."""
    monkeypatch.setattr("conveyor.delivery.presence.ASK_EVERY_S", 0.05)
    presence = Presence(node, "regressor")
    with Node("regressor", "r1", config=node.config, run="r1"):
        wait_until(lambda: presence.names() == {"r1"}, what="the token")
        presence._subscriber.undeclare()
        presence._names.discard("r1")
        presence._names.put("r2", None)
        wait_until(lambda: presence.names() == {"r1"}, what="who is there, and no one else")


def test_no_router_is_one_clear_error(free_port: int) -> None:
    link = LinkConfig(router=f"tcp/127.0.0.1:{free_port}", connect_timeout_s=0.3)
    with pytest.raises(LinkError, match=rf"no router answered at tcp/127.0.0.1:{free_port}.*tuberline router"):
        open_client(link, name="observer")


def test_a_taken_port_is_one_clear_error(link: LinkConfig, tmp_path: Path) -> None:
    import sys

    done = subprocess.run(
        [sys.executable, "-m", "tuberline", "router", "--listen", link.router],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 2
    assert link.router in done.stderr
    assert "Traceback" not in done.stderr
