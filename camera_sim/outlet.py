"""Where a camera's frames go: straight to its segmenter on the same host, by the router to all others who listen."""

from __future__ import annotations

import time
from contextlib import ExitStack
from types import TracebackType
from typing import Self

from conveyor import topics
from conveyor.config import LineConfig
from conveyor.delivery import LatestPublisher
from conveyor.direct import DirectLink, direct_endpoint
from conveyor.frame_ring import MOST_SLOTS, SLOTS, RingOutlet, ring_path
from conveyor.messages import Frame
from conveyor.node import Node

ALONE_S = 10.0


class FrameOutlet:
    """Publishes frames, each encoded once. A context manager.

    With a direct link the router sees a frame only while somebody beyond listens: a recorder, a viewer; one frame in a
    fifth of a second where the viewer shows no more. Counters: `frames_direct`, `frames_by_router`, `frames_few`: how
    many went which way; `frames_in_memory`: of the direct ones, those that the link told of and shared memory held.
    """

    def __init__(self, node: Node, config: LineConfig, *, codec: str) -> None:
        self._counters = node.counters
        self._log = node.log
        self._codec = codec
        self._alone_since_s, self._told = time.monotonic(), False
        self._stack = ExitStack()
        self._by_router = LatestPublisher(node, topics.FRAME, camera=node.name)
        self._few = LatestPublisher(node, topics.FRAME_FEW, camera=node.name)
        self._few_tick: int | None = None
        endpoint = self._endpoint = direct_endpoint(config.camera(node.name), node.name)
        self._direct: LatestPublisher | None = None
        self._ring: RingOutlet | None = None
        if endpoint is not None:
            link = self._stack.enter_context(DirectLink.open(node, endpoint, link=config.link, listens=False))
            self._direct = LatestPublisher(link, topics.FRAME, camera=node.name)
            path, slots = ring_path(endpoint), max(SLOTS, config.camera(node.name).window + 2)
            if path is not None and slots <= MOST_SLOTS:
                self._ring = RingOutlet(link, path, camera=node.name, slots=slots)
                self._stack.callback(self._ring.close)
        for counter in ("frames_direct", "frames_in_memory", "frames_by_router", "frames_few"):
            node.counters.add(counter, 0)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def _watch(self, has_listener: bool) -> None:
        """Frames that no segmenter gets are told once, and again when it was there."""
        now_s = time.monotonic()
        if has_listener:
            self._alone_since_s, self._told = now_s, False
        elif not self._told and now_s - self._alone_since_s >= ALONE_S:
            self._told = True
            self._log.warning(
                "no segmenter takes frames %s for %.0f s: is it running, and told the same (cameras.NAME.direct)?%s",
                f"at {self._endpoint}" if self._endpoint else "by the router",
                ALONE_S,
                "" if self._endpoint else " That of a `tuberline run` takes those of that run's camera alone",
            )

    @property
    def has_segmenter(self) -> bool:
        """The segmenter listens; without a direct link, somebody does."""
        return (self._by_router if self._direct is None else self._direct).has_listener

    def put(self, frame: Frame) -> None:
        """Send `frame` to everyone who listens now. Returns at once; a loss shows at the receiver as a gap."""
        to_router = self._by_router.has_listener
        to_direct = self._direct is not None and self._direct.has_listener
        to_few = self._few.has_listener and self._is_first(frame.captured_ns)
        self._watch(to_router if self._direct is None else to_direct)
        if not (to_router or to_direct or to_few):
            return
        data = frame.encode(codec=self._codec)
        if self._direct is not None and to_direct:
            if self._ring is not None and self._ring.put(data):
                self._counters.add("frames_in_memory")
            else:
                self._direct.put_encoded(data)
            self._counters.add("frames_direct")
        if to_router:
            self._by_router.put_encoded(data)
            self._counters.add("frames_by_router")
        if to_few:
            self._few.put_encoded(data)
            self._counters.add("frames_few")

    def _is_first(self, captured_ns: int) -> bool:
        """Whether none was sent yet of this tick of capture time; the ticks are those of all cameras."""
        tick = captured_ns * topics.FEW_PER_S // 1_000_000_000
        first, self._few_tick = tick != self._few_tick, tick
        return first
