"""A real segmenter whose camera sends frames with other intrinsics, another depth unit or pose in between."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from conveyor import topics
from conveyor.config import LinkConfig
from conveyor.delivery import KeptSubscriber, LatestPublisher
from conveyor.messages import Frame, FrameProgress
from conveyor.node import Node
from conveyor.observer import Observer
from conveyor.reasons import FrameDrop
from segmenter.frame.constants import SAME_POSE
from segmenter.frame.gate import FrameGate
from tests.camera_sim.camera_process import RUN, line, process
from tests.conftest import wait_until
from tests.segmenter.segmenter_scene import Body, Scene

pytestmark = [pytest.mark.graph, pytest.mark.timeout(150)]
FRAMES, CHANGED = 14, {4: "intrinsics", 8: "unit", 11: "pose"}


def test_such_frames_are_refused_counted_and_told_and_the_run_goes_on(link: LinkConfig, tmp_path: Path) -> None:
    """One of them ended the segmenter for good. Two cameras swapped were seen where the other one hung: of 281 tubers
    that such a line counted 100 lay nowhere.
    """
    config = line(link)
    scene = Scene([Body(-0.3, 0.0)])
    with (
        Node("camera", "front", config=config, run=RUN) as camera,
        Observer(link, line=config.name) as observer,
        process(config, tmp_path, "segmenter", "--camera", "front") as segmenter,
    ):
        frames = LatestPublisher(camera, topics.FRAME, camera="front")
        progress = KeptSubscriber(camera, topics.FRAME_PROGRESS, FrameProgress, camera="front")
        wait_until(lambda: "segmenter/front" in observer.alive(), what="the segmenter", timeout_s=100)

        def send(frame: Frame) -> None:
            """Send it until the segmenter says that it is done, as a camera that waits does."""

            def done() -> bool:
                frames.put(frame)
                camera.progress()
                progress.wait(0.5)
                return any(word.done_seq >= frame.seq for word in progress.latest().values())

            wait_until(done, what=f"frame {frame.seq}")

        for seq in range(FRAMES):
            frame = scene.frame(seq, 0.01 * seq)
            frame = replace(frame, captured_ns=(seq + 10) * 100_000_000, after_seq=seq - 1)
            if CHANGED.get(seq) == "intrinsics":
                frame = replace(frame, intrinsics=replace(frame.intrinsics, fx=frame.intrinsics.fx + 1))
            if CHANGED.get(seq) == "unit":
                frame = replace(frame, depth_scale_m=0.0001)
            if CHANGED.get(seq) == "pose":
                assert frame.belt_from_camera is not None
                aside = frame.belt_from_camera.copy()
                aside[1, 3] += 0.5
                frame = replace(frame, belt_from_camera=aside)
            send(frame)

        def level(name: str) -> float:
            counters = observer.nodes().get("segmenter/front")
            return counters.gauges.get(name, 0) if counters else 0

        wait_until(lambda: level("frames_dropped_camera_changed") == len(CHANGED), what="all refusals")
        wait_until(lambda: level("frames_processed") == FRAMES - len(CHANGED), what="the others")
        assert segmenter.poll() is None
        segmenter.terminate()
        _, said = segmenter.communicate(timeout=20)
        refused = re.findall(r"refused frame (\d+), the (\d+)\. of run r1 unlike the first frame, with (\w+)", said)
        assert refused == [("4", "1", "intrinsics"), ("8", "2", "depth")]  # the 1., 2., 4., 8.: no flood


def test_what_changed_is_said_with_both_values() -> None:
    scene = Scene([Body(-0.3, 0.0)])
    first = scene.frame(0, 0.0)
    pose = first.belt_from_camera
    assert pose is not None
    swapped, shaken = pose.copy(), pose.copy()
    swapped[1, 3] += 0.594
    shaken[1, 3] += 0.9 * SAME_POSE
    cases = [
        (replace(first, belt_from_camera=swapped), f"pose (belt_from_camera) {swapped[:3].round(4).tolist()} and not "),
        (replace(first, belt_from_camera=None), "a pose (belt_from_camera) in one of both only"),
        (replace(first, depth_scale_m=0.0001), "depth unit 0.0001 m and not 0.001 m"),
        (replace(first, belt_from_camera=shaken), ""),
        (first, ""),
    ]
    gate = FrameGate()
    assert gate.drop(first) is None
    for frame, said in cases:
        assert (gate.drop(frame) is FrameDrop.CAMERA_CHANGED) == bool(said)
        assert gate.changed.startswith(said)
        assert bool(gate.changed) == bool(said)
