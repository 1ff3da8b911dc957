"""The travel that a camera's process lays under its frames, told by a real encoder node over a real router."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from camera_sim import stamped as under_test
from camera_sim.stamped import FrameStamper
from conveyor import topics
from conveyor.config import LinkConfig
from conveyor.config_encoder import EncoderConfig
from conveyor.delivery import LatestPublisher
from conveyor.geometry import Intrinsics
from conveyor.messages import Frame, Travel
from conveyor.node import Node
from tests.conftest import sender_and_receiver, wait_until

SETTINGS = EncoderConfig(source="simulated:", metres_per_pulse=0.001)


@pytest.fixture
def nodes(link: LinkConfig) -> Iterator[tuple[Node, Node]]:
    """The encoder's, and the camera's."""
    with sender_and_receiver(link) as both:
        yield both


def frame(seq: int, *, age_s: float = 0.04) -> Frame:
    """Taken so long ago, by this machine's clock."""
    depth = np.full((4, 4), 460, np.uint16)
    now_ns = time.time_ns() - round(age_s * 1e9)
    return Frame("front", "r1", seq, now_ns, None, 0.001, Intrinsics(4, 4, 4.0, 4.0, 2.0, 2.0), 0.46, depth)


class Belt:
    """An encoder's node, told by hand: the belt runs 0.5 m/s since this was made."""

    def __init__(self, node: Node) -> None:
        self._out = LatestPublisher(node, topics.TRAVEL, source=SETTINGS.name)
        self._run = node.run
        self._began_ns = time.time_ns()

    def at(self, captured_ns: int) -> float:
        return 0.5 * (captured_ns - self._began_ns) / 1e9

    def wait_for_listener(self) -> None:
        """What is told before the router knows of one is lost."""
        wait_until(lambda: self._out.has_listener, what="a camera that listens")

    def tell(self, *, run: str | None = None) -> None:
        now_ns = time.time_ns()
        self._out.put(Travel(SETTINGS.name, run or self._run, now_ns, self.at(now_ns), False))

    def tell_for(self, seconds: float) -> None:
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            self.tell()
            time.sleep(0.01)


def heard(stamper: FrameStamper, node: Node, messages: int) -> None:
    wait_until(lambda: node.counters.get("travel_received") >= messages, what="what the encoder told")


def test_the_first_frame_of_a_run_is_one_that_the_encoder_tells_of(nodes: tuple[Node, Node]) -> None:
    """The frame that came with its first word had been taken before it: the run went by the load to its end."""
    encoder, camera = nodes
    stamper, belt = FrameStamper(camera, SETTINGS), Belt(encoder)
    assert stamper.first(frame(0), segmenter=True) is None, "nothing is told yet"
    belt.wait_for_listener()
    belt.tell(run="yesterday")
    heard(stamper, camera, 1)
    assert stamper.first(frame(1), segmenter=True) is None, "not of this run"
    belt.tell()
    belt.tell()
    heard(stamper, camera, 3)
    assert stamper.first(frame(2, age_s=0.2), segmenter=True) is None, "it was taken before"
    belt.tell_for(0.2)
    came = frame(3, age_s=0.05)
    told = stamper.first(came, segmenter=True)
    assert told is not None
    assert told.travel_m == pytest.approx(belt.at(came.captured_ns), abs=0.004)
    assert camera.counters.get("frames_with_travel") == 1
    assert camera.counters.get("frames_without_travel") == 0, "held back, not sent without"


def test_a_run_whose_encoder_tells_nothing_goes_by_the_load(
    nodes: tuple[Node, Node], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It waits for its segmenter, and then for the encoder; a frame with travel of its own waits for nothing."""
    monkeypatch.setattr(under_test, "FIRST_WITHIN_S", 0.2)
    monkeypatch.setattr(under_test, "ALONE_WITHIN_S", 0.2)
    _, camera = nodes
    own = replace(frame(0), travel_m=1.5)
    stamper = FrameStamper(camera, SETTINGS)
    sent = stamper.first(own, segmenter=True)
    assert sent is not None
    assert sent.encode() == own.encode()
    for segmenter in (True, False):
        stamper, began_s = FrameStamper(camera, SETTINGS), time.monotonic()
        while (sent := stamper.first(frame(1), segmenter=segmenter)) is None:
            time.sleep(0.01)
        assert sent.travel_m is None
        assert time.monotonic() - began_s >= (0.2 if segmenter else 0.4)


def test_an_encoder_that_falls_silent_is_told_and_comes_back(nodes: tuple[Node, Node]) -> None:
    encoder, camera = nodes
    stamper, belt = FrameStamper(camera, SETTINGS), Belt(encoder)
    belt.tell_for(0.2)
    assert stamper.stamped(frame(0)).travel_m is not None
    time.sleep(0.7)
    assert stamper.stamped(frame(1)).travel_m is None
    assert camera.counters.snapshot()[1]["encoder_silent_s"] >= 0.5
    belt.tell_for(0.2)
    assert stamper.stamped(frame(2)).travel_m is not None
    assert camera.counters.snapshot()[1]["encoder_silent_s"] == 0.0
