"""The regressor's process: views in, weights out. Any number of them, anywhere; each is one single-threaded worker.

The dispatcher sends a worker no more views than it gave it credits for, so the inbox never overflows in an orderly
line; should it do so, the loss is counted and the dispatcher sends the view again. A view that comes twice is weighed
once and answered twice, with the same bits: a worker slower than the dispatcher's deadline is sent views again before
it comes to them, and would fall behind for ever if it weighed all of these.
"""

from __future__ import annotations

import time
import zlib
from collections import OrderedDict

import numpy as np
import torch

from conveyor import topics
from conveyor.config import LineConfig
from conveyor.delivery.latest import LatestSubscriber
from conveyor.delivery.reliable import ReliablePublisher
from conveyor.errors import ConfigError
from conveyor.geometry import Intrinsics, straight_down_belt_from_camera
from conveyor.messages import View, Weight
from conveyor.node import Node
from regressor.network.fast import Form
from regressor.serve.service import WeightsService
from regressor.weigh.prepare import REASONS
from regressor.weigh.weigher import Weigher, weigh_view

INBOX_VIEWS = 1024
REMEMBERED_ANSWERS = 8192
WARM_UP_ROUNDS = 3


def run_regressor(config: LineConfig, *, name: str, run: str) -> None:
    """Weigh views until stopped. The liveliness token appears only when the worker is warm.

    Raises:
        ConfigError: a device this build cannot use.
        InputError: weights that cannot be used.
    """
    if config.regressor.device != "cpu":
        raise ConfigError(
            f"regressor.device is '{config.regressor.device}', the workers weigh on 'cpu': one core does about 100 "
            "views a second; start more processes instead"
        )
    torch.set_num_threads(config.regressor.threads)
    weigher = Weigher.load(config.regressor.weights, Form(config.regressor.precision, config.regressor.centroids))
    warm_up(weigher)
    with Node("regressor", name, config=config, run=run, announce=False) as node:
        service = WeightsService(node, weigher)
        try:
            _Worker(node, service).work()
        finally:
            service.close()


class _Worker:
    """The loop around one weigher at a time."""

    def __init__(self, node: Node, service: WeightsService) -> None:
        self._node = node
        self._service = service
        self._inbox = LatestSubscriber(node, topics.VIEW, View, capacity=INBOX_VIEWS, regressor=node.name)
        self._answers: dict[str, ReliablePublisher] = {}
        self._answered: OrderedDict[tuple[str, int], Weight] = OrderedDict()
        for counter in ("views_weighed", "views_duplicate", *(f"views_refused_{reason}" for reason in REASONS)):
            node.counters.add(counter, 0)

    def work(self) -> None:
        """Announce, then weigh view after view; between two of them, change over to other weights."""
        node = self._node
        self._weigher = self._service.open()
        node.announce()
        node.log.info("ready with %s", self._weigher.sidecar.model_id)
        while not node.stop.is_set():
            node.progress()
            self._weigher = self._service.turn()
            view = self._inbox.get(0.2)
            node.counters.gauge("queue", len(self._inbox))
            if view is not None:
                begun = time.perf_counter()
                self._answer(view)
                node.counters.gauge("last_ms", 1e3 * (time.perf_counter() - begun))

    def _answer(self, view: View) -> None:
        # With a checksum: another run of the same recording may cut the same tuber out differently.
        key = (view.view_id, zlib.crc32(view.depth.data))
        weight = self._answered.get(key)
        if weight is not None:
            self._node.counters.add("views_duplicate")
        else:
            weight = self._answered[key] = weigh_view(self._weigher, view, regressor=self._node.name)
            self._count(weight)
            if len(self._answered) > REMEMBERED_ANSWERS:
                self._answered.popitem(last=False)
        self._publisher(view.camera).put(weight)

    def _count(self, weight: Weight) -> None:
        if weight.status == "refused":
            self._node.counters.add(f"views_refused_{weight.reason}")
            self._node.log.warning("refused view %s: %s", weight.view_id, REASONS[weight.reason])
        else:
            self._node.counters.add("views_weighed")

    def _publisher(self, camera: str) -> ReliablePublisher:
        if camera not in self._answers:
            self._answers[camera] = ReliablePublisher(self._node, topics.WEIGHT, camera=camera)
        return self._answers[camera]


def warm_up(weigher: Weigher) -> None:
    """Weigh a made-up tuber a few times: compiles the kernels and touches the memory before the first real view."""
    rows, columns = np.mgrid[-60:61, -60:61]
    dome = 0.04**2 - (rows**2 + columns**2) * 0.0006**2
    depth = np.where(dome > 0, np.round((0.33 - np.sqrt(np.maximum(dome, 0))) * 1000), 0).astype(np.uint16)
    view = View(
        view_id="warm-up/0",
        track_id="warm-up",
        camera="none",
        run="none",
        seq=0,
        captured_ns=0,
        rank=0,
        depth_scale_m=0.001,
        intrinsics=Intrinsics(width=1280, height=720, fx=653.8, fy=652.1, cx=643.5, cy=366.1),
        u0=580,
        v0=300,
        depth=depth,
        belt_from_camera=straight_down_belt_from_camera(0.345),
    )
    # As it comes from the wire: its arrays are read-only, which is another type to the compiler.
    received = View.decode(view.encode())
    for _ in range(WARM_UP_ROUNDS):
        weigh_view(weigher, received, regressor="warm-up")
