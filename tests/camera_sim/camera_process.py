"""A camera process under test, and the other side of its line in this process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from conveyor import topics
from conveyor.config import LineConfig, LinkConfig, dump_toml
from conveyor.config_camera import CameraConfig
from conveyor.delivery import KeptPublisher, KeptSubscriber, LatestSubscriber
from conveyor.delivery.endpoint import Endpoint
from conveyor.direct import DirectLink, direct_endpoint
from conveyor.frame_ring import RingInlet, ring_path
from conveyor.messages import CameraInfo, Counters, Frame, FrameProgress
from conveyor.node import Node
from tests.conftest import wait_until

RUN = "r1"


def line(link: LinkConfig, **camera: object) -> LineConfig:
    """A line with one camera 'front'."""
    return LineConfig(link=link, cameras={"front": CameraConfig.model_validate(camera)})


@contextmanager
def process(config: LineConfig, folder: Path, *args: str) -> Iterator[subprocess.Popen[str]]:
    """`tuberline <args> --config ... --run r1` while the block lasts; killed afterwards if it is still there."""
    path = folder / "line.toml"
    path.write_text(dump_toml(config))
    command = [sys.executable, "-m", "tuberline", *args, "--config", str(path), "--run", RUN]
    running = subprocess.Popen(
        command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"}
    )
    try:
        yield running
    finally:
        running.kill()
        running.communicate()


class OtherSide:
    """What a segmenter and an observer would see of the camera, and the progress that the former would tell.

    `source`: where its frames come from; `ring`: and the memory that they lie in.
    """

    def __init__(self, node: Node, source: Endpoint, ring: Path | None = None) -> None:
        self.node = node
        self.frames = LatestSubscriber(source, topics.FRAME, Frame, capacity=512, camera="front")
        self._ring = RingInlet(source, ring, self.frames, camera="front") if ring else None
        self._infos = KeptSubscriber(node, topics.CAMERA_INFO, CameraInfo, camera="front")
        self._counters = KeptSubscriber(node, topics.COUNTERS, Counters, role="*", name="*")
        self._progress = KeptPublisher(node, topics.FRAME_PROGRESS, camera="front")
        self.seen: list[int] = []

    def done(self, seq: int, window: int = 4) -> None:
        """Say that all frames up to `seq` are done."""
        self._progress.put(FrameProgress(camera="front", run=RUN, done_seq=seq, window=window))

    def info(self) -> CameraInfo | None:
        """The camera's newest word."""
        return next(iter(self._infos.latest().values()), None)

    def wait_for_state(self, state: str) -> CameraInfo:
        """The camera's word once it says `state`."""
        wait_until(lambda: (i := self.info()) is not None and i.state == state, what=f"the camera to be {state}")
        info = self.info()
        assert info is not None
        return info

    def counters(self, role: str = "camera") -> Counters | None:
        """Newest counters of the node with that role."""
        return next((c for c in self._counters.latest().values() if c.role == role), None)

    def take(self, timeout_s: float = 0.0) -> list[int]:
        """Numbers of the frames that arrived since the last call."""
        new = []
        while (frame := self.frames.get(timeout_s)) is not None:
            new.append(frame.seq)
            timeout_s = 0.0
        self.seen += new
        return new

    def follow(self, last_seq: int, *, done_seq: int) -> None:
        """Take everything up to `last_seq`, saying only what arrived without a gap after `done_seq` is done."""

        def all_here() -> bool:
            nonlocal done_seq
            self.take(0.1)
            while done_seq + 1 in self.seen:
                done_seq += 1
            self.done(done_seq)
            return done_seq >= last_seq

        wait_until(all_here, what=f"frame {last_seq}; seen: {sorted(set(self.seen))}")


@contextmanager
def other_side(config: LineConfig) -> Iterator[OtherSide]:
    """A node of this process; the test run's own signal handlers come back afterwards."""
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        with Node("segmenter", "front", config=config, run=RUN) as node, ExitStack() as stack:
            endpoint = direct_endpoint(config.camera("front"), "front")
            direct = None if endpoint is None else DirectLink.open(node, endpoint, link=config.link, listens=True)
            source = stack.enter_context(direct) if direct else node
            yield OtherSide(node, source, ring_path(endpoint) if endpoint else None)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
