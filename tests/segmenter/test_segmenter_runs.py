"""A segmenter's runs: the camera's newest one goes on, whatever comes late of those before."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh

from conveyor import topics
from conveyor.config import CameraConfig, LineConfig, LinkConfig
from conveyor.messages import Committed, Frame
from conveyor.session import open_client
from segmenter.node import SegmenterNode
from tests.conftest import wait_until
from tests.segmenter.segmenter_scene import MEDIUM, Body, Scene, scattered

SCENE = Scene([Body(-0.3, 0.0)])
LINE = LineConfig(cameras={"front": CameraConfig(source="realsense", belt_distance_m=0.46)})


class _Sockets:
    """In place of the node's links: what is sent goes nowhere, and everything that a run logged is committed."""

    has_listener = False

    def __init__(self, node: Any) -> None:
        self._node = node

    def __getattr__(self, name: str) -> Callable[..., Any]:
        return lambda *_: set() if name == "names" else {}

    def latest(self) -> dict[str, Committed]:
        runs = self._node._runs.values()
        return {run.run: Committed(camera="front", run=run.run, n=run.log.newest) for run in runs}


@pytest.fixture(params=["a log on disk", "none"])
def node(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Any]:
    """A segmenter without sockets, in run r1."""
    kept = LINE.segmenter.model_copy(update={"state_dir": tmp_path if request.param == "a log on disk" else None})
    found: Any = SegmenterNode(LINE.model_copy(update={"segmenter": kept}), "front", "r1")
    for link in ("_committed", "_regressors", "_log_out", "_progress", "_travel", "_in_view", "_pictures"):
        setattr(found, link, _Sockets(found))
    found._open_run("r1")
    yield found
    for camera_run in found._runs.values():
        camera_run.close()


def frame(run: str, seq: int) -> Frame:
    return replace(SCENE.frame(seq, 0.01 * seq), run=run, captured_ns=10**9 + seq * 33_000_000)


def give(node: Any, run: str, seqs: range) -> None:
    for seq in seqs:
        node._take_frame(frame(run, seq), 0.033 * seq)
        for camera_run in list(node._runs.values()):
            node._serve(camera_run, 0.033 * seq)


def test_a_late_frame_of_a_finished_run_ends_nothing(node: Any) -> None:
    """It opened its run again, which ended the newest one. With a log on disk no frame was processed any more; without
    one the newest run began again, with entries that the aggregator has under their numbers already."""
    give(node, "r1", range(4))
    give(node, "r2", range(4))
    assert list(node._runs) == ["r2"], "the first run is over, and all of it is committed"
    give(node, "r1", range(4, 5))
    give(node, "r2", range(4, 8))
    assert (node._current.run, list(node._runs)) == ("r2", ["r2"])
    assert node._current.frames.processed == 8
    assert not node._current.ended
    assert node._node.counters.get("frames_of_older_runs") == 1


def test_a_new_run_starts_its_levels_anew(node: Any) -> None:
    """What the run before had dropped stayed among the new run's levels, which then added up no more: a page told of
    dark frames, and an alarm of a belt that is off rang, for as long as the process lived."""
    dark = frame("r1", 0)
    node._take_frame(replace(dark, depth=np.zeros_like(dark.depth)), 0.0)
    give(node, "r1", range(1, 4))
    node._node.counters.gauge("belt_alarm", 1.0)
    node._report()
    assert levels(node)["frames_dropped_blind"] == 1.0
    give(node, "r2", range(5))
    node._report()
    told = levels(node)
    assert told["frames_processed"] == told["frames_received"] == 5.0
    assert told.get("frames_dropped_blind", 0.0) == 0.0
    assert told.get("belt_alarm", 0.0) == 0.0
    assert told["belt_backwards"] == 0.0


def levels(node: Any) -> dict[str, float]:
    """As a report tells them."""
    return node._node.counters.snapshot()[1]  # type: ignore[no-any-return]


def test_reports_name_the_run_that_they_tell_of(node: Any) -> None:
    """They named the first one: the aggregator of the next run took no report for its own, so that it compared no
    clocks of cameras and did not know who had its last acknowledgement."""
    give(node, "r1", range(2))
    assert node._node.run == "r1"
    give(node, "r2", range(2))
    assert node._node.run == "r2"
    give(node, "r1", range(2, 3))
    assert node._node.run == "r2"


def test_a_new_run_and_a_new_process_know_the_camera(node: Any, tmp_path: Path) -> None:
    """Each learned it afresh: the first twenty tubers of every run were weighed as if nothing were known of it."""
    scene = Scene([replace(b, place_x_m=2 * b.place_x_m) for b in scattered(10, seed=4)], MEDIUM)
    for seq in range(44):
        node._take_frame(replace(scene.frame(seq, 0.03 * seq), run="r1"), 0.033 * seq)
    learned = node._current.core.outlines
    assert learned is not None
    seen = replace(scene.frame(0, 0.0), run="r2", captured_ns=10**10)
    node._take_frame(seen, 2.0)
    assert node._current.run == "r2"
    assert node._current.core.outlines == learned
    node._remember()
    later: Any = SegmenterNode(node._config, "front", "r3")
    later._memory.look(go_on=later._goes_on)
    known = later._memory.known_in("r3")
    assert (known is not None) == (node._config.segmenter.state_dir is not None)
    assert known is None or known.outlines == node._current.core.known.outlines


def test_another_camera_is_told_and_learned_afresh(node: Any, caplog: pytest.LogCaptureFixture) -> None:
    scene = Scene([replace(b, place_x_m=2 * b.place_x_m) for b in scattered(10, seed=4)], MEDIUM)
    for seq in range(44):
        node._take_frame(replace(scene.frame(seq, 0.03 * seq), run="r1"), 0.033 * seq)
    assert node._current.core.outlines is not None
    with caplog.at_level("INFO"):
        give(node, "r2", range(3))
    assert node._current.core.outlines is None
    assert caplog.text.count("is not of this one, its image or its intrinsics are others") == 1


@pytest.mark.graph
def test_a_regressor_that_left_takes_its_publisher_along(link: LinkConfig) -> None:
    """Each that ever joined, under its own name, kept one in the segmenter's session for as long as that lived."""
    line = LINE.model_copy(update={"link": link})
    found: Any = SegmenterNode(line, "front", "r1")
    with found._node as node, ExitStack() as stack, open_client(link, name="regressors") as session:
        found._open_links(node, stack)
        found._open_run("r1")
        keys = [topics.ALIVE.key(line.name, role="regressor", name=f"r{n}") for n in range(3)]
        tokens = [session.liveliness().declare_token(key) for key in keys]
        wait_until(lambda: found._regressors.names() == {"r0", "r1", "r2"}, what="three regressors")
        works = {name: found._work(name) for name in ("r0", "r1", "r2")}
        for n in (0, 2):
            tokens[n].undeclare()
        wait_until(lambda: found._turn() or set(found._works) == {"r1"}, what="two to leave")
        works["r1"].put_encoded(b"x")
        with pytest.raises(zenoh.ZError):
            works["r0"].put_encoded(b"x")
        for camera_run in found._runs.values():
            camera_run.close()
