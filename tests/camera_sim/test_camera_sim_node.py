"""The camera's process on a real router: it loses nothing while it waits, and holds up no one when it does not."""

from __future__ import annotations

import json
import signal
import time
from pathlib import Path

import pytest

from conveyor.config import LinkConfig
from conveyor.formats import describe_recording
from tests.camera_sim.camera_process import line, other_side, process
from tests.conftest import wait_until

pytestmark = pytest.mark.graph


def _count(recording: Path) -> int:
    return describe_recording(recording).cameras[0].frames or 0


def test_a_replay_waits_for_the_segmenter_and_loses_nothing(
    link: LinkConfig, small_recording: Path, tmp_path: Path
) -> None:
    config, frames = line(link, path=small_recording, speed=0, window=3), _count(small_recording)
    with other_side(config) as side, process(config, tmp_path, "camera", "--camera", "front") as camera:
        side.wait_for_state("starting")
        assert side.take() == []  # no one asked for frames yet
        side.done(-1)
        wait_until(lambda: side.take() is not None and len(side.seen) >= 3, what="the first window")
        wait_until(
            lambda: (c := side.counters()) and c.gauges.get("waiting_for_segmenter_s", 0) > 0.5, what="it to wait"
        )
        side.take()
        assert set(side.seen) == {0, 1, 2}  # perhaps more than once, but none beyond the window
        side.follow(frames - 1, done_seq=2)
        info = side.wait_for_state("ended")
        assert sorted(set(side.seen)) == list(range(frames))
        assert (info.published, info.first_seq, info.last_seq, info.refused) == (frames, 0, frames - 1, {})
        assert info.waits
        camera.send_signal(signal.SIGTERM)
        assert camera.wait(30) == 0  # within 2 s by its own clock: later, it leaves with 70


def test_unacknowledged_frames_come_again_and_a_killed_camera_goes_on_where_it_was(
    link: LinkConfig, small_recording: Path, tmp_path: Path
) -> None:
    config, frames = line(link, path=small_recording, speed=0, window=2), _count(small_recording)
    with other_side(config) as side:
        side.done(-1)
        with process(config, tmp_path, "camera", "--camera", "front") as camera:
            wait_until(lambda: side.take(0.1) is not None and side.seen.count(1) >= 1, what="frame 1")
            assert side.take(2.5) == [], "frames were sent again to a segmenter that says nothing"

            def asked_again() -> bool:
                side.done(-1)
                side.take(0.1)
                return side.seen.count(1) >= 2

            wait_until(asked_again, what="frame 1 twice")
            assert set(side.seen) == {0, 1}
            side.done(1)
            wait_until(lambda: side.take(0.1) is not None and 3 in side.seen, what="frame 3")
            camera.kill()
        side.done(2)
        side.seen.clear()
        with process(config, tmp_path, "camera", "--camera", "front"):
            wait_until(lambda: side.take(0.1) is not None and side.seen, what="frames of the second process")
            side.follow(frames - 1, done_seq=2)
            side.wait_for_state("ended")
        assert sorted(set(side.seen)) == list(range(3, frames))  # frame 2 was done, frame 3 not


def test_a_replay_that_is_stopped_in_the_middle_has_not_ended_and_goes_on(
    link: LinkConfig, small_recording: Path, tmp_path: Path
) -> None:
    config, frames = line(link, path=small_recording, speed=0, window=2), _count(small_recording)
    with other_side(config) as side:
        side.done(-1)
        with process(config, tmp_path, "camera", "--camera", "front") as camera:
            wait_until(lambda: side.take(0.1) is not None and 1 in side.seen, what="frame 1")
            camera.send_signal(signal.SIGTERM)
            _, said = camera.communicate(timeout=30)
            assert camera.returncode == 0
        assert "ended after" not in said  # a segmenter would take it for the end of the run
        side.done(0)
        with process(config, tmp_path, "camera", "--camera", "front"):
            side.follow(frames - 1, done_seq=0)
            side.wait_for_state("ended")


def test_a_live_camera_that_is_stopped_has_not_ended_and_numbers_on(
    link: LinkConfig, small_recording: Path, tmp_path: Path
) -> None:
    """It said so, and its segmenter took no frame of the process that followed."""
    config = line(link, path=small_recording, waits=False, speed=0.3, starts_at_s=time.time() + 1.0)
    with other_side(config) as side:
        with process(config, tmp_path, "camera", "--camera", "front") as camera:
            wait_until(lambda: side.take(0.1) is not None and side.seen, what="a frame")
            camera.send_signal(signal.SIGTERM)
            _, said = camera.communicate(timeout=30)
            assert camera.returncode == 0
        assert "ended after" not in said
        side.take(0.5)  # what was on its way
        info, before = side.info(), side.seen[-1]
        assert info is not None
        assert info.state == "streaming"
        side.done(before)
        with process(config, tmp_path, "camera", "--camera", "front"):
            info = side.wait_for_state("ended")  # that overtakes a frame on its way
            wait_until(lambda: side.take(0.1) is not None and side.seen[-1] >= info.last_seq, what="the last frame")
        assert side.seen == sorted(set(side.seen))
        assert before < side.seen[-1] == info.last_seq == _count(small_recording) - 1


def test_without_waiting_nobody_holds_it_up_and_late_joiners_learn_that_it_ended(
    link: LinkConfig, small_recording: Path, tmp_path: Path
) -> None:
    depth = small_recording / "front" / "depth"
    (depth / "000003.png").write_bytes((depth / "000003.png").read_bytes()[:500])
    (depth / "000005.png").unlink()
    frames = _count(small_recording)
    config = line(link, path=small_recording, speed=0, waits=False, compress="zstd")
    with process(config, tmp_path, "camera", "--camera", "front"):
        with other_side(config) as early:
            early.wait_for_state("ended")
        with other_side(config) as late:
            info = late.wait_for_state("ended")
            wait_until(lambda: (c := late.counters()) and c.values.get("frames_refused") == 2, what="its counters")
            counters = late.counters()
            assert counters is not None
    assert info.refused == {"broken_png": 1, "missing_file": 1}
    assert (info.published, info.last_seq, info.waits) == (frames - 2, frames - 1, False)
    assert counters.values["frames_published"] == frames - 2
    assert counters.values["frames_refused_broken_png"] == 1


def test_real_time_is_kept(link: LinkConfig, small_recording: Path, tmp_path: Path) -> None:
    config = line(link, path=small_recording, speed=4.0, waits=False)
    with other_side(config) as side, process(config, tmp_path, "camera", "--camera", "front"):
        wait_until(lambda: side.take(0.05) != [], what="the first frame")
        started, first = time.monotonic(), side.seen[0]
        side.wait_for_state("ended")
        side.take()
        took_s = time.monotonic() - started
    expected_s = (side.seen[-1] - first) / 10.0 / 4.0
    assert took_s > expected_s - 0.2


def test_a_wrong_depth_scale_ends_it_with_one_clear_error(
    link: LinkConfig, small_recording: Path, tmp_path: Path
) -> None:
    path = small_recording / "front" / "camera.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"depth_scale_m": 0.0001}))
    config = line(link, path=small_recording, waits=False)
    with process(config, tmp_path, "camera", "--camera", "front") as camera:
        camera.send_signal(0)
        _, said = camera.communicate(timeout=30)
        assert camera.returncode == 2
    assert "depth_scale_m is 0.0001 and should be 0.001" in said
    assert "Traceback" not in said
