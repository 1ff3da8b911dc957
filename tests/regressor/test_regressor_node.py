"""The regressor's process over a real router: it announces itself when warm, answers each view, counts, and stops."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import zenoh

from conveyor import topics
from conveyor.config import LineConfig, LinkConfig, RegressorConfig, dump_toml
from conveyor.delivery import KeptSubscriber, LatestPublisher, Presence, ReliableSubscriber
from conveyor.errors import InputError
from conveyor.geometry import straight_down_belt_from_camera
from conveyor.messages import Counters, Weight
from conveyor.node import Node
from regressor.serve.form import form_of
from regressor.serve.link import states
from regressor.serve.node import ANSWERED_CAMERAS, run_regressor
from regressor.weigh.weigher import BATCHED, Weigher, weigh_view
from tests.conftest import wait_until
from tests.regressor.ellipsoids import ellipsoid_view

pytestmark = pytest.mark.graph


@pytest.fixture
def node(link: LinkConfig) -> Iterator[Node]:
    with Node("segmenter", "front", config=LineConfig(link=link), run="run") as node:
        yield node


@pytest.fixture
def worker(node: Node, tmp_path: Path) -> Iterator[subprocess.Popen[bytes]]:
    with _running(node, tmp_path) as process:
        yield process


@contextmanager
def _running(node: Node, tmp_path: Path) -> Iterator[subprocess.Popen[bytes]]:
    """`tuberline regressor` as its own process, announced when this returns."""
    path = tmp_path / "line.toml"
    path.write_text(dump_toml(node.config))
    presence = Presence(node, "regressor")
    arguments = ["regressor", "--config", str(path), "--name", "r1", "--run", "run"]
    process = subprocess.Popen([sys.executable, "-m", "tuberline", *arguments])
    wait_until(lambda: presence.names() == {"r1"}, what="the worker's token", timeout_s=60)
    yield process
    process.kill()
    process.wait(30)


def test_views_are_answered_counted_and_the_worker_stops(node: Node, worker: subprocess.Popen[bytes]) -> None:
    answers = ReliableSubscriber(node, topics.WEIGHT, Weight, camera="front")
    counters = KeptSubscriber(node, topics.COUNTERS, Counters, role="regressor", name="*")
    work = LatestPublisher(node, topics.VIEW, regressor="r1")
    wait_until(lambda: work.has_listener, what="the worker's subscription")
    view = ellipsoid_view(name="t1/0")
    empty = replace(ellipsoid_view(name="t2/0"), depth=np.zeros((9, 9), np.uint16))
    low = replace(ellipsoid_view(name="t3/0"), belt_from_camera=straight_down_belt_from_camera(0.28))
    # Its belt stated otherwise is another view: it got the answer to the first.
    deeper = replace(view, resting_offset_m=0.004)
    all_sent = (view, empty, low, view, deeper)
    for sent in all_sent:
        work.put(sent)
    got = [answers.get(20.0) for _ in all_sent]
    weigher = Weigher.load()
    weigher = weigher.in_form(form_of(node.config, weigher))
    expected = [weigh_view(weigher, sent, regressor="r1") for sent in all_sent]
    assert got == expected

    def counted() -> bool:
        values = next((message.values for message in counters.latest().values()), {})
        refused = ("views_refused_empty_cloud", "views_refused_below_belt")
        names = ("view_received", "views_weighed", *refused, "views_duplicate")
        return [values.get(name) for name in names] == [5, 2, 1, 1, 1]

    wait_until(counted, what="the worker's counters")
    # Each name that a sender ever called its camera had a publisher with its cache, for good.
    everyone = ReliableSubscriber(node, topics.WEIGHT, Weight, camera="*")
    wanted = {f"c{at}" for at in range(ANSWERED_CAMERAS + 6)}
    for camera in sorted(wanted):
        work.put(replace(empty, camera=camera, view_id=f"{camera}/0"))
    told: set[str] = set()
    while not wanted <= told and (weight := everyone.get(20.0)) is not None:
        told.add(weight.camera)
    assert wanted <= told

    def publishing() -> set[str]:
        tokens = node.session.liveliness().get(f"{topics.WEIGHT.key(node.line, camera='*')}/@adv/pub/**")
        return {str(reply.ok.key_expr).split("/@adv/")[0] for reply in tokens if reply.ok is not None}

    wait_until(lambda: len(publishing()) == ANSWERED_CAMERAS, what="the publishers of cameras heard of last")
    assert topics.WEIGHT.key(node.line, camera="front") not in publishing()
    # One that refuses to say what it weighs with, in whatever bytes, hid all others; these ended who looked round.
    key = topics.QUERY_MODEL.key(node.line, regressor="r0")
    node.session.declare_queryable(key, zenoh.handlers.Callback(_refuse, indirect=True))
    assert set(states(node.session, node.line)) == {"r1"}
    assert "libtorch" not in Path(f"/proc/{worker.pid}/maps").read_text(), "two seconds and 200 MB for nothing"
    os.kill(worker.pid, signal.SIGTERM)
    assert worker.wait(30) == 0


def _refuse(query: zenoh.Query) -> None:
    query.reply_err(b"\xff")
    query.drop()  # type: ignore[no-untyped-call, unused-ignore]


def test_a_worker_on_a_gpu_answers_as_one_without(link: LinkConfig, tmp_path: Path) -> None:
    """Each answer is that of the CPU, to rounding, and says that it was batched."""
    if not torch.cuda.is_available():
        pytest.skip("no CUDA GPU here: a worker on one was NOT tried")
    config = LineConfig(link=link, regressor=RegressorConfig(device="cuda"))
    with Node("segmenter", "front", config=config, run="run") as node, _running(node, tmp_path):
        answers = ReliableSubscriber(node, topics.WEIGHT, Weight, camera="front")
        work = LatestPublisher(node, topics.VIEW, regressor="r1")
        wait_until(lambda: work.has_listener, what="the worker's subscription")
        views = [ellipsoid_view((0.03 + n / 1e4, 0.028, 0.022), name=f"t{n}/0") for n in range(24)]
        for view in views:
            work.put(view)
        got = {weight.view_id: weight for weight in (answers.get(30.0) for _ in views) if weight is not None}
    weigher = Weigher.load()
    for view in views:
        expected = weigh_view(weigher, view, regressor="r1")
        assert got[view.view_id].weight_g == pytest.approx(expected.weight_g, rel=1e-4)
        assert got[view.view_id].flags == (*expected.flags, BATCHED)


@pytest.mark.skipif(torch.cuda.is_available(), reason="a CUDA GPU is here")
def test_a_device_that_cannot_be_used_is_refused() -> None:
    config = LineConfig(regressor=RegressorConfig(device="cuda"))
    with pytest.raises(InputError, match="finds no CUDA GPU here; use 'cpu'"):
        run_regressor(config, name="r1", run="run")
