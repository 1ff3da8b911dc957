"""No producer waits for whoever watches: a frozen watcher costs neither `put` nor the readers that work any time.

Two cameras publish in turn in one loop, so that the machine's load meets both alike; a watcher of one of them stands
still until the router can hold nothing more for it.
"""

from __future__ import annotations

import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
import zenoh

from conveyor import topics
from conveyor.config import LineConfig, LinkConfig
from conveyor.delivery import KeptPublisher, LatestPublisher, LatestSubscriber, ReliablePublisher
from conveyor.geometry import Intrinsics
from conveyor.messages import Frame
from conveyor.node import Node
from tests.conftest import wait_until

pytestmark = [pytest.mark.graph, pytest.mark.timeout(120)]
CAMERAS = ("watched", "alone")
FRAMES = 60
DROP_MS = 50.0
"""The longest that a router of Zenoh's tries before it drops a message in pieces; with BLOCK a put waits 5 s."""

WATCHER = """
import sys
import zenoh
from conveyor.config import LinkConfig
from conveyor.session import open_client
got = []
session = open_client(LinkConfig(router=sys.argv[1]), name="watcher")
subscriber = session.declare_subscriber(sys.argv[2], zenoh.handlers.Callback(lambda _: got.append(1), indirect=False))
print("watching", flush=True)
for _ in sys.stdin:
    print(len(got), flush=True)
session.close()
"""


def frame(camera: str, seq: int) -> Frame:
    """848 x 480 pixels, 0.8 MB."""
    return Frame(
        camera=camera, run="r1", seq=seq, captured_ns=seq, travel_m=None, depth_scale_m=0.001,
        intrinsics=Intrinsics(848, 480, 430.0, 430.0, 424.0, 240.0), belt_distance_m=None, belt_from_camera=None,
        depth=np.full((480, 848), 400 + seq, np.uint16),
    )  # fmt: skip


@contextmanager
def watcher(router: str, key: str) -> Iterator[subprocess.Popen[str]]:
    """A process that counts what is published on `key`; told a line, it prints the number."""
    command = [sys.executable, "-c", WATCHER, router, key]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "watching\n"
            yield process
        finally:
            process.kill()


def count(process: subprocess.Popen[str]) -> int:
    """What a watcher has got."""
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write("\n")
    process.stdin.flush()
    return int(process.stdout.readline())


def settled(process: subprocess.Popen[str]) -> int:
    """What a watcher has got, once no more comes for half a second."""
    seen, since = count(process), time.monotonic()
    while time.monotonic() < since + 0.5:
        time.sleep(0.02)
        if (now := count(process)) != seen:
            seen, since = now, time.monotonic()
    return seen


def test_every_kind_of_publisher_drops_on_a_full_link(link: LinkConfig) -> None:
    """With BLOCK, one frozen reader holds its publisher and all others up for 5 s before the router gives it up."""
    with Node("segmenter", "front", config=LineConfig(link=link), run="r1") as node:
        publishers = (
            LatestPublisher(node, topics.FRAME, camera="front"),
            ReliablePublisher(node, topics.TRACK, camera="front"),
            KeptPublisher(node, topics.FRAME_PROGRESS, camera="front"),
        )
        for publisher in publishers:
            assert publisher._publisher.congestion_control == zenoh.CongestionControl.DROP


def test_a_frozen_watcher_makes_no_put_longer_and_no_reader_miss_a_frame(link: LinkConfig) -> None:
    with Node("camera", "watched", config=LineConfig(link=link), run="r1") as node:
        publishers = {camera: LatestPublisher(node, topics.FRAME, camera=camera) for camera in CAMERAS}
        readers = {camera: LatestSubscriber(node, topics.FRAME, Frame, camera=camera) for camera in CAMERAS}
        with watcher(link.router, topics.FRAME.key(node.line, camera="watched")) as watching:

            def passed(camera: str, seq: int) -> float:
                """Publish a frame, in milliseconds, and wait until the reader has it."""
                begun = time.perf_counter()
                publishers[camera].put(frame(camera, seq))
                took_ms = 1e3 * (time.perf_counter() - begun)
                got = readers[camera].get(20.0)
                assert got is not None, f"the reader of {camera} waited 20 s for frame {seq}"
                assert got.seq == seq
                return took_ms

            for publisher in publishers.values():
                wait_until(lambda p=publisher: p.has_listener, what="a reader")  # type: ignore[misc]
            wait_until(lambda: passed("watched", 0) and count(watching), what="the watcher sees a frame")
            before = count(watching)
            watching.send_signal(signal.SIGSTOP)
            took_ms = [{camera: passed(camera, seq) for camera in CAMERAS} for seq in range(1, FRAMES + 1)]
            watching.send_signal(signal.SIGCONT)
            late = settled(watching) - before
    assert late < FRAMES, "the watcher missed nothing: the router never ran out of room for it"
    watched_ms, alone_ms = (statistics.median(took[camera] for took in took_ms) for camera in CAMERAS)
    sys.stdout.write(f"median put {watched_ms:.2f} ms watched, {alone_ms:.2f} ms alone; the watcher got {late}\n")
    assert watched_ms - alone_ms < DROP_MS
