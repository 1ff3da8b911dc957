"""The regressor's process: views in, weights out. Any number of them, anywhere; each is one single-threaded worker.

The dispatcher sends a worker no more views than it gave it credits for, so the inbox never overflows in an orderly
line; should it do so, the loss is counted and the dispatcher sends the view again. A view that comes twice is weighed
once and answered twice, with the same bits: a worker slower than the dispatcher's deadline is sent views again before
it comes to them, and would fall behind forever if it weighed all of these.
"""

from __future__ import annotations

import time
import zlib
from collections import OrderedDict

from conveyor import topics
from conveyor.config import LineConfig
from conveyor.delivery.latest import LatestSubscriber
from conveyor.delivery.reliable import ReliablePublisher
from conveyor.kernels import compiled_once
from conveyor.messages import View, Weight
from conveyor.node import Node
from conveyor.threads import use_threads
from regressor.network.fast import multiplies_bfloat16
from regressor.serve.form import form_of, made_up_view
from regressor.serve.service import WeightsService
from regressor.serve.unseen import Lookout
from regressor.weigh.prepare import REASONS
from regressor.weigh.weigher import Weigher, weigh_view, weigh_views

INBOX_VIEWS = 1024
REMEMBERED_ANSWERS = 8192
"""As bytes, for half a kilobyte each: as objects they took 10 MB in half an hour under load."""
ANSWERED_CAMERAS = 64
"""Cameras whose answers are kept for who missed them, 2 MB each; beyond, the one not heard of for longest goes: the
dispatcher sends again what it has no answer to. A view's camera is whatever its sender calls it.
"""
WARM_UP_ROUNDS = 3
BATCH_WAIT_S = 0.002
MOST_TOGETHER = 128
"""What a device weighs in one pass: those views that come within this time of the first, so many at most."""


def run_regressor(config: LineConfig, *, name: str, run: str) -> None:
    """Weigh views until stopped. The liveliness token appears only when the worker is warm.

    Raises:
        InputError: weights that cannot be used, or a device that is not here.
    """
    use_threads(config.regressor.threads)
    weigher = Weigher.load(config.regressor.weights)
    if config.regressor.device != "cpu":
        weigher = weigher.on(config.regressor.device)
    else:
        weigher = weigher.in_form(form_of(config, weigher))
    with compiled_once("views"):
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
        self._answers: OrderedDict[str, ReliablePublisher] = OrderedDict()
        self._answered: OrderedDict[tuple[str, int], bytes] = OrderedDict()
        for counter in ("views_weighed", "views_duplicate", *(f"views_refused_{reason}" for reason in REASONS)):
            node.counters.add(counter, 0)

    def work(self) -> None:
        """Announce, then weigh view after view; between two of them, change over to other weights."""
        node = self._node
        self._weigher = self._service.open()
        node.announce()
        lookout = Lookout(node)
        form = self._weigher.form
        node.log.info(
            "ready with %s in %s, %s centroids, on %s",
            self._weigher.sidecar.model_id,
            form.precision,
            form.centroids or "all",
            self._weigher.device or "cpu",
        )
        if form.precision == "bfloat16" and not multiplies_bfloat16():
            node.log.warning(
                'regressor.precision = "bfloat16" asks for products that this processor lacks (AVX-512 or '
                'AVX-NE-CONVERT): each view takes some thirty times as long; set it to "auto"'
            )
        while not node.stop.is_set():
            node.progress()
            self._weigher = self._service.turn()
            views = self._take()
            lookout.look(at_work=bool(views))
            node.counters.gauge("queue", len(self._inbox))
            if views:
                begun = time.perf_counter()
                self._answer(views)
                node.counters.gauge("last_ms", 1e3 * (time.perf_counter() - begun))
                node.counters.gauge("batch", len(views))

    def _take(self) -> list[View]:
        """The next view; on a device that weighs many at once, those too that come within `BATCH_WAIT_S`."""
        first = self._inbox.get(0.2)
        views = [] if first is None else [first]
        if first is None or self._weigher.device is None:
            return views
        until_s = time.monotonic() + BATCH_WAIT_S
        while (
            len(views) < MOST_TOGETHER and (view := self._inbox.get(max(0.0, until_s - time.monotonic()))) is not None
        ):
            views.append(view)
        return views

    def _answer(self, views: list[View]) -> None:
        # With a checksum: another run of the same recording may cut the same tuber out, or state its belt, differently.
        keys = [(view.view_id, zlib.crc32(view.encode())) for view in views]
        fresh = {key: view for key, view in zip(keys, views, strict=True) if key not in self._answered}
        self._node.counters.add("views_duplicate", len(views) - len(fresh))
        weights = weigh_views(self._weigher, list(fresh.values()), regressor=self._node.name) if fresh else []
        answers = dict(zip(fresh, weights, strict=True))
        for key, weight in answers.items():
            self._answered[key] = weight.encode()
            self._count(weight)
        for key, view in zip(keys, views, strict=True):
            answer = answers.get(key) or Weight.decode(self._answered[key])
            told = answer.within(view.takes)
            data = self._answered[key] if told is answer else told.encode()
            self._publisher(view.camera).put_encoded(data)
        while len(self._answered) > REMEMBERED_ANSWERS:
            self._answered.popitem(last=False)

    def _count(self, weight: Weight) -> None:
        if weight.status == "refused":
            self._node.counters.add(f"views_refused_{weight.reason}")
            self._node.log.warning("refused view %s: %s", weight.view_id, REASONS[weight.reason])
        else:
            self._node.counters.add("views_weighed")

    def _publisher(self, camera: str) -> ReliablePublisher:
        if camera not in self._answers:
            self._answers[camera] = ReliablePublisher(self._node, topics.WEIGHT, camera=camera)
        self._answers.move_to_end(camera)
        if len(self._answers) > ANSWERED_CAMERAS:
            self._answers.popitem(last=False)[1].close()
        return self._answers[camera]


def warm_up(weigher: Weigher) -> None:
    """Weigh made-up tubers a few times: compiles the kernels and touches the memory before the first real view.

    A large and a small one, which a GPU samples by kernels of their own.
    """
    received = [made_up_view(0.040, 0.036, 0.030), made_up_view(0.016, 0.014, 0.012)]
    for _ in range(WARM_UP_ROUNDS):
        for view in received:
            weigh_view(weigher, view, regressor="warm-up")
