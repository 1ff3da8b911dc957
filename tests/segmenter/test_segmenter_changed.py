"""A real segmenter whose camera sends frames with other intrinsics or another depth unit in between."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from conveyor import topics
from conveyor.config import LinkConfig
from conveyor.delivery import KeptSubscriber, LatestPublisher
from conveyor.messages import Frame, FrameProgress
from conveyor.node import Node
from conveyor.observer import Observer
from tests.camera_sim.camera_process import RUN, line, process
from tests.conftest import wait_until
from tests.segmenter.segmenter_scene import Body, Scene

pytestmark = [pytest.mark.graph, pytest.mark.timeout(150)]
FRAMES, CHANGED = 12, {4: "intrinsics", 8: "unit"}


def test_such_frames_are_refused_counted_and_told_and_the_run_goes_on(link: LinkConfig, tmp_path: Path) -> None:
    """One of them ended the segmenter for good."""
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
            send(frame)

        def level(name: str) -> float:
            counters = observer.nodes().get("segmenter/front")
            return counters.gauges.get(name, 0) if counters else 0

        wait_until(lambda: level("frames_dropped_camera_changed") == len(CHANGED), what="both refusals")
        wait_until(lambda: level("frames_processed") == FRAMES - len(CHANGED), what="the others")
        assert segmenter.poll() is None
        segmenter.terminate()
        _, said = segmenter.communicate(timeout=20)
        assert "refused frame 4, the 1. of run r1" in said
        assert "refused frame 8, the 2. of run r1" in said
