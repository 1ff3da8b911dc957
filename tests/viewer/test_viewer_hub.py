"""A live hub that hangs, dies, comes late or comes back: the subscriber never notices, and every loss has a number."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import viewer_line as line

from conveyor import topics
from conveyor.delivery import KeptPublisher, LatestPublisher, ReliablePublisher
from conveyor.observer import Observer

pytest.importorskip("rerun")
pytestmark = pytest.mark.graph

from viewer.rerun.launch import Ports, RerunProgram  # noqa: E402


@contextlib.contextmanager
def deaf_hub() -> Iterator[str]:
    """URL of something that accepts connections and never reads from them."""
    with socket.socket() as server, contextlib.ExitStack() as held:
        server.bind(("127.0.0.1", 0))
        server.listen(8)
        server.settimeout(0.1)
        done = threading.Event()

        def accept() -> None:
            while not done.is_set():
                with contextlib.suppress(TimeoutError):
                    held.enter_context(server.accept()[0])

        thread = threading.Thread(target=accept)
        thread.start()
        try:
            yield f"rerun+http://127.0.0.1:{server.getsockname()[1]}/proxy"
        finally:
            done.set()
            thread.join()


@contextlib.contextmanager
def belt(node: Observer) -> Iterator[None]:
    """Publishes frames at 30 Hz and a tuber per frame in the background, until left."""
    tubers = line.potatoes(3, seed=21)
    made = [line.frame(seq, tubers) for seq in range(8)]
    info = KeptPublisher(node, topics.CAMERA_INFO, camera="front")
    info.put(line.camera_info())
    frames = LatestPublisher(node, topics.FRAME, camera="front")
    counted = ReliablePublisher(node, topics.TUBER)
    line.within(10, lambda: frames.has_listener, "the viewer subscribes to frames")
    done = threading.Event()

    def publish() -> None:
        seq = 0
        while not done.wait(1 / line.FPS):
            frame = made[seq % len(made)]
            moved = replace(frame, seq=seq, captured_ns=line.moment_ns(seq), travel_m=line.travel_m(seq))
            frames.put(moved)
            counted.put(line.counted(tubers[seq % len(tubers)]))
            seq += 1

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def goes_on(watcher: line.ViewerProcess) -> None:
    """More frames arrive at the viewer, by its own reports."""
    before = watcher.counter("frame_front_received")
    line.within(10, lambda: watcher.counter("frame_front_received") >= before + 20, "the subscriber goes on")


def test_a_hub_that_never_reads_delays_nothing_and_is_left_in_time(tmp_path: Path) -> None:
    with (
        line.router() as link,
        deaf_hub() as url,
        line.viewer(link, tmp_path, "--connect", url, "--profile", "full") as watcher,
        belt(watcher.observer),
    ):
        line.within(15, lambda: watcher.counter("hub_stalls") == 1, "the hub is found to take nothing")
        line.within(15, lambda: watcher.counter("hub_dropped_superseded") > 0, "pictures are left out, counted")
        goes_on(watcher)
        assert watcher.counter("stalls") == 0
        watcher.stop()


def test_without_a_hub_it_goes_on_looking_and_the_queue_stays_bounded(tmp_path: Path) -> None:
    url = f"rerun+http://127.0.0.1:{line.free_port()}/proxy"
    with (
        line.router() as link,
        line.viewer(link, tmp_path, "--connect", url, "--profile", "full") as watcher,
        belt(watcher.observer),
    ):
        line.within(15, lambda: watcher.counter("hub_dropped_superseded") > 20, "pictures are left out, counted")
        assert watcher.counter("hub_connects") == 0
        assert watcher.gauge("hub_waiting") < 16384 + 256
        watcher.stop()


def test_a_real_hub_that_freezes_dies_and_returns_is_found_again(tmp_path: Path) -> None:
    ports = Ports(line.free_port(), line.free_port())
    with (
        line.router() as link,
        line.viewer(link, tmp_path, "--connect", ports.url, "--profile", "full") as watcher,
        belt(watcher.observer),
    ):
        with RerunProgram(ports, page=True) as hub:
            line.within(15, lambda: watcher.counter("hub_sent") > 100, "a late hub is found")
            os.kill(hub.pid, signal.SIGSTOP)
            line.within(20, lambda: watcher.counter("hub_stalls") >= 1, "the frozen hub is noticed")
            goes_on(watcher)
            os.kill(hub.pid, signal.SIGCONT)
            thawed = watcher.counter("hub_sent")
            line.within(15, lambda: watcher.counter("hub_sent") > thawed + 100, "the thawed hub gets more")
        line.within(15, lambda: watcher.gauge("hub_connected") == 0, "the dead hub is noticed")
        with RerunProgram(ports, page=True):
            again = watcher.counter("hub_sent")
            line.within(20, lambda: watcher.counter("hub_connects") == 2, "the new hub is found")
            line.within(15, lambda: watcher.counter("hub_sent") > again + 100, "the new hub gets more")
            watcher.stop()
