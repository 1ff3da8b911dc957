"""What was sent and did not arrive, the first messages included, is asked for, put in its place, and counted where its
sender does not give it.

The subscriber here is a plain one but where the link is cut: of a sender that spoke before it, it always hears a later
message first, as an advanced subscriber does in an unlucky moment.
"""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

import pytest
import zenoh
from zenoh import ext

from conveyor import topics
from conveyor.config import LinkConfig
from conveyor.delivery import ReliablePublisher
from conveyor.delivery.gaps import PATIENCE_S, Gaps
from conveyor.messages import Committed
from conveyor.node import Node
from tests.conftest import sender_and_receiver, start_router, wait_until

pytestmark = pytest.mark.graph


@pytest.fixture
def nodes(link: LinkConfig) -> Iterator[tuple[Node, Node]]:
    with sender_and_receiver(link) as nodes:
        yield nodes


@dataclass
class Heard:
    """What came through, and what did not."""

    payloads: list[bytes] = field(default_factory=list)
    lost: list[int] = field(default_factory=list)

    def gaps(self, node: Node, *, cache: int = 100, patience_s: float = PATIENCE_S) -> Gaps:
        return Gaps(
            node.session,
            lambda sample: self.payloads.append(sample.payload.to_bytes()),
            cache=cache,
            lost=self.lost.append,
            log=logging.getLogger("test"),
            patience_s=patience_s,
        )

    def listen(self, node: Node, key: str, *, patience_s: float = PATIENCE_S) -> None:
        gaps = self.gaps(node, patience_s=patience_s)
        node.session.declare_subscriber(key, zenoh.handlers.Callback(gaps.push, indirect=False))


class Mute:
    """A sender whose next message is number `sent` and whose cache says only that it cannot answer, or nothing."""

    def __init__(self, node: Node, key: str, *, sent: int, answers: bool = True) -> None:
        self._publisher = node.session.declare_publisher(key)
        self._sent = sent
        self._kept: list[zenoh.Query] | None = None if answers else []
        self.asked: list[str] = []
        source = self._publisher.id
        node.session.declare_queryable(f"{key}/@adv/pub/{source.zid}/{source.eid}/_", self._on_query)

    def put(self, payload: bytes) -> None:
        self._publisher.put(payload, source_info=zenoh.SourceInfo(self._publisher.id, self._sent))
        self._sent += 1

    @property
    def has_listener(self) -> bool:
        return bool(self._publisher.matching_status.matching)  # type: ignore[attr-defined]

    def _on_query(self, query: zenoh.Query) -> None:
        if self._kept is not None:
            self._kept.append(query)
            self.asked.append("")
            return
        with query:
            self.asked.append(query.parameters["_sn"])
            query.reply_err(b"busy")


def test_the_beginning_comes_before_what_was_heard_first(nodes: tuple[Node, Node]) -> None:
    sender, receiver = nodes
    out = ReliablePublisher(sender, topics.COMMITTED, camera="front")
    sent = [Committed("front", "r1", n) for n in range(5)]
    for message in sent:
        out.put(message)
    heard = Heard()
    heard.listen(receiver, topics.COMMITTED.key(receiver.line, camera="*"))

    next_s = time.monotonic()

    def one_more() -> list[bytes]:
        nonlocal next_s
        if time.monotonic() >= next_s:  # a starved router tells late of the listener, and `cache` is 100 messages
            next_s = time.monotonic() + 0.3
            sent.append(Committed("front", "r1", len(sent)))
            out.put(sent[-1])
        return heard.payloads

    # A router that is told of the listener between two puts lets the first one through and not the second: a plain
    # subscriber, which hears no heartbeat, knows of that only by a third.
    wait_until(lambda: len(one_more()) >= len(sent), what="all of them")
    assert heard.payloads == [message.encode() for message in sent]
    assert heard.lost == []


SENDER = """
import sys, time
from conveyor import topics
from conveyor.config import LineConfig, LinkConfig
from conveyor.delivery import ReliablePublisher
from conveyor.messages import Committed
from conveyor.node import Node

with Node("segmenter", "frozen", config=LineConfig(link=LinkConfig(router=sys.argv[1])), run="r1") as node:
    out = ReliablePublisher(node, topics.COMMITTED, camera="front")
    for n in range(10**9):
        out.put(Committed("front", "r1", n))
        if n == 5:
            print("begun", flush=True)
        time.sleep(0.01)
"""


def test_a_frozen_sender_is_asked_again_and_what_came_meanwhile_waits(
    nodes: tuple[Node, Node], link: LinkConfig, caplog: pytest.LogCaptureFixture
) -> None:
    receiver = nodes[1]
    came: list[zenoh.Sample] = []
    heard = Heard()
    gaps = heard.gaps(receiver)
    sender = subprocess.Popen([sys.executable, "-c", SENDER, link.router], stdout=subprocess.PIPE)
    assert sender.stdout is not None
    try:
        assert sender.stdout.readline() == b"begun\n"
        receiver.session.declare_subscriber(topics.COMMITTED.key(receiver.line, camera="front"), came.append)
        wait_until(lambda: len(came) >= 6, what="six messages")
        sender.send_signal(signal.SIGSTOP)
        os.waitpid(sender.pid, os.WUNTRACED)  # until all of its threads stand still: a quick one answers first
        gaps.push(came[3])
        wait_until(lambda: "no answer to the question" in caplog.text, what="the first question to go unanswered")
        gaps.push(came[4])
        gaps.push(came[5])
        assert heard.payloads == []
        sender.send_signal(signal.SIGCONT)
        newest = Committed.decode(came[5].payload.to_bytes()).n
        wait_until(lambda: len(heard.payloads) == newest + 1, what="the beginning")
    finally:
        sender.kill()
        sender.communicate()
    assert [Committed.decode(payload).n for payload in heard.payloads] == list(range(newest + 1))
    assert heard.lost == []


def test_a_cache_that_never_answers_is_a_loss_with_a_count(
    nodes: tuple[Node, Node], caplog: pytest.LogCaptureFixture
) -> None:
    out = Mute(nodes[0], "tests/numbers", sent=2)
    heard = Heard()
    heard.listen(nodes[1], "tests/*", patience_s=0.5)
    wait_until(lambda: out.has_listener, what="the listener")
    out.put(b"2")
    wait_until(lambda: heard.payloads, what="what there is")
    out.put(b"3")
    wait_until(lambda: len(heard.payloads) == 2, what="the next one")
    assert heard.payloads == [b"2", b"3"]
    assert heard.lost == [2]
    assert out.asked == ["0..2"] * 2
    assert "no answer to the question for messages 0 to 1 of tests/numbers" in caplog.text


def test_what_the_cache_no_longer_holds_is_no_loss(nodes: tuple[Node, Node]) -> None:
    sender, receiver = nodes
    key = topics.COMMITTED.key(receiver.line, camera="front")
    out = ext.declare_advanced_publisher(
        sender.session,
        key,
        cache=ext.CacheConfig(3),
        sample_miss_detection=ext.MissDetectionConfig(heartbeat=0.3, sporadic_heartbeat=None),
    )
    came: list[zenoh.Sample] = []
    receiver.session.declare_subscriber(key, came.append)
    wait_until(lambda: out.put(f"{len(came)}") or len(came) >= 10, what="ten messages")
    heard = Heard()
    gaps = heard.gaps(receiver, cache=3)
    for sample in came[5:10]:
        gaps.push(sample)
    wait_until(lambda: len(heard.payloads) == 5, what="the answer, empty")
    assert heard.payloads == [sample.payload.to_bytes() for sample in came[5:10]]
    assert heard.lost == []


def test_a_gap_that_zenoh_gave_up_is_asked_for(nodes: tuple[Node, Node]) -> None:
    """It asks once: when the link was cut just then, a message was lost though its sender lived and held it."""
    sender, receiver = nodes
    out = ReliablePublisher(sender, topics.COMMITTED, camera="front")
    came: list[zenoh.Sample] = []
    receiver.session.declare_subscriber(topics.COMMITTED.key(receiver.line, camera="front"), came.append)
    sent = 0

    def one_more() -> bool:
        nonlocal sent
        out.put(Committed("front", "r1", sent))
        sent += 1
        return len(came) >= 9

    wait_until(one_more, what="nine messages")
    first = Committed.decode(came[0].payload.to_bytes()).n
    heard = Heard()
    gaps = heard.gaps(receiver)
    for n in (0, 3, 4, 8, 2):  # two gaps, and one that comes although it was asked for
        gaps.push(came[n])
    wait_until(lambda: len(heard.payloads) == first + 9, what="all of them")
    assert [Committed.decode(payload).n for payload in heard.payloads] == list(range(first + 9))
    assert heard.lost == []


def test_a_gap_that_the_cache_no_longer_holds_is_a_loss_with_a_count(nodes: tuple[Node, Node]) -> None:
    sender, receiver = nodes
    key = topics.COMMITTED.key(receiver.line, camera="front")
    numbered = ext.MissDetectionConfig(heartbeat=0.3, sporadic_heartbeat=None)
    out = ext.declare_advanced_publisher(sender.session, key, cache=ext.CacheConfig(3), sample_miss_detection=numbered)
    came: list[zenoh.Sample] = []
    receiver.session.declare_subscriber(key, came.append)
    wait_until(lambda: out.put(f"{len(came)}") or len(came) >= 10, what="ten messages")
    heard = Heard()
    gaps = heard.gaps(receiver, cache=3)
    for n in (0, 5, 6, 7, 8, 9):
        gaps.push(came[n])
    wait_until(lambda: len(heard.payloads) == 6, what="what there is")
    assert sum(heard.lost) == 4


def test_a_link_that_is_cut_while_the_first_messages_are_asked_for_blocks_nothing(free_port: int) -> None:
    """Zenoh then hands over what waited while it takes the link down: a question asked within that callback stopped
    the node's session forever, and with it each call of Zenoh and the goodbye.
    """
    endpoint = f"tcp/127.0.0.1:{free_port}"
    router = start_router(endpoint)
    with sender_and_receiver(LinkConfig(router=endpoint)) as (sender, receiver):
        out = Mute(sender, "tests/numbers", sent=2, answers=False)
        probe = "tests/numbers/@adv/**"
        wait_until(lambda: receiver.session.get(probe, lambda _: None) or out.asked, what="that its cache is known")
        out.asked.clear()
        heard = Heard()
        subscriber = ext.declare_advanced_subscriber(
            receiver.session,
            "tests/*",
            zenoh.handlers.Callback(heard.gaps(receiver, patience_s=0.5).push, indirect=False),
            history=ext.HistoryConfig(detect_late_publishers=True),
            recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
        )
        wait_until(lambda: out.asked and out.has_listener, what="the question for its first ones")
        out.put(b"2")
        arrived: list[zenoh.Sample] = []
        receiver.session.declare_subscriber("tests/*", arrived.append)
        wait_until(lambda: out.put(b"more") or arrived, what="that they are there")
        assert heard.payloads == []
        router.kill()
        router.wait(30)
        wait_until(lambda: heard.payloads[:1] == [b"2"], what="what waited")
        assert heard.lost == [2]
        subscriber.undeclare()


def test_a_session_that_is_closed_ends_its_questions_without_a_word_too_many(link: LinkConfig) -> None:
    with sender_and_receiver(link) as (sender, receiver):
        out = ReliablePublisher(sender, topics.COMMITTED, camera="front")
        came: list[zenoh.Sample] = []
        receiver.session.declare_subscriber(topics.COMMITTED.key(receiver.line, camera="front"), came.append)
        wait_until(lambda: out.put(Committed("front", "r1", len(came))) or len(came) >= 3, what="three messages")
        heard = Heard()
        gaps = heard.gaps(receiver)
    gaps.push(came[2])
    wait_until(lambda: heard.payloads, what="what there is")
    assert heard.payloads == [came[2].payload.to_bytes()]


def test_a_plain_put_needs_no_beginning(nodes: tuple[Node, Node]) -> None:
    heard = Heard()
    heard.listen(nodes[1], "tests/*")
    publisher = nodes[0].session.declare_publisher("tests/plain")
    wait_until(lambda: publisher.matching_status.matching, what="the listener")  # type: ignore[attr-defined]
    publisher.put(b"plain")
    wait_until(lambda: heard.payloads == [b"plain"], what="the put")
