"""ROS 2 topics over Zenoh as a live source, from a publisher that writes the bytes of rmw_zenoh. No ROS was at hand."""

from __future__ import annotations

import signal
import threading
from itertools import count, pairwise
from pathlib import Path

import numpy as np
import pytest

from camera_sim.live.rmw_zenoh import Attachment, Numbering, key_of, published_topic, read_attachment
from conveyor.config import CameraConfig, LinkConfig
from conveyor.errors import ConfigError, InputError, MessageError
from conveyor.messages import Frame
from tests.camera_sim.camera_process import RUN, line, other_side, process
from tests.conftest import wait_until

pytest.importorskip("rosbags.typesys")

from camera_sim.live import ros2 as ros2_live
from tests.camera_sim.ros2_publisher import Ros2Camera, ros2_session
from tests.formats.bag_messages import HEIGHT, compressed_depth, depth_mm, image, info, stamp_ns

TOPIC = "/camera/camera/depth/image_rect_raw"
ONE, TWO = b"\x01" * 16, b"\x02" * 16


def test_keys_attachments_and_tokens_are_those_of_rmw_zenoh() -> None:
    """Values from public logs and the design document of rmw_zenoh."""
    assert key_of("/spike/colorbars", "sensor_msgs/msg/Image", domain=0, type_hash="RIHS01_d31d") == (
        "0/spike/colorbars/sensor_msgs::msg::dds_::Image_/RIHS01_d31d"
    )
    assert read_attachment(bytes([5, *[0] * 7, 9, *[0] * 7, 16]) + ONE) == Attachment(5, 9, ONE)
    for bad in (b"", bytes(32), bytes(34), bytes([0] * 16 + [15] + [0] * 16)):
        with pytest.raises(MessageError, match="its attachment has"):
            read_attachment(bad)
    token = (
        "@ros2_lv/0/b89f/1/5/MP/%/%/cam/%camera%depth%image_raw/sensor_msgs::msg::dds_::Image_/RIHS01_x/::,10:,:,:,,"
    )
    assert published_topic(token) == ("/camera/depth/image_raw", "sensor_msgs/msg/Image")
    assert published_topic("@ros2_lv/0/b89f/0/0/NN/%/%/cam") is None


def test_lost_messages_are_gaps_and_a_publisher_that_starts_again_leaves_one_too() -> None:
    numbering = Numbering(after=99, fps=10.0)
    numbers = [numbering.number(Attachment(n, 0, ONE), 100_000_000 * n) for n in (41, 42, 45, 44, 45, 46)]
    assert numbers == [100, 101, 104, None, None, 105]
    # The other publisher's first frame comes 1.5 s later: 14 frames passed unseen.
    assert numbering.number(Attachment(1, 0, TWO), 100_000_000 * 46 + 1_500_000_000) == 120
    assert numbering.number(Attachment(2, 0, TWO), 100_000_000 * 62) == 121
    assert numbering.refused() == 122
    assert numbering.number(Attachment(3, 0, TWO), 100_000_000 * 63) == 123
    with pytest.raises(ConfigError, match="two ROS nodes publish"):
        numbering.number(Attachment(47, 0, ONE), 100_000_000 * 64)


@pytest.mark.graph
def test_a_camera_process_hears_ros_2_and_counts_what_is_lost(link: LinkConfig, tmp_path: Path) -> None:
    config = line(link, source="ros2", topic=TOPIC, ros_domain=7, belt_distance_m=0.46)
    skips = {12: 3, 20: 1}
    with ros2_session(link) as session, other_side(config) as side:
        camera = Ros2Camera(session, TOPIC, gid=ONE, domain=7)
        got: dict[int, Frame] = {}

        def publish_until(enough: int, numbers: count) -> None:  # type: ignore[type-arg]
            def more() -> bool:
                n = next(numbers)
                camera.publish(image(n % 50, pad=4), info(), skip=skips.pop(len(got), 0))
                frame = side.frames.get(0.05)
                if frame is not None:
                    got[frame.seq] = frame
                return len(got) >= enough

            wait_until(more, what=f"{enough} frames; came: {sorted(got)}")

        numbers = count()
        with process(config, tmp_path, "camera", "--camera", "front") as running:
            publish_until(30, numbers)
            camera.stop()
            camera = Ros2Camera(session, TOPIC, gid=TWO, domain=7)
            publish_until(36, numbers)
            info_now = side.wait_for_state("streaming")
            assert (info_now.run, info_now.source) == (RUN, f"ROS 2 topic {TOPIC}, domain 7, over Zenoh")
            seqs = sorted(got)
            wait_until(
                lambda: (c := side.counters()) and c.count("frames_missed") >= seqs[-1] - seqs[0] + 1 - len(seqs),
                what="the lost ones to be counted",
            )
            assert seqs[-1] - seqs[0] + 1 - len(seqs) >= 4
            assert not skips
            for frame in got.values():
                n = round((frame.captured_ns - stamp_ns(0)) / (stamp_ns(1) - stamp_ns(0)))
                # The stamps go back to the first after 50 images; a clock that steps back is steadied, to a frame.
                near = (n,) if n < 50 else (n - 1, n, n + 1)
                assert any(np.array_equal(frame.depth, depth_mm(one % 50)) for one in near)
                assert (frame.depth_scale_m, frame.belt_distance_m, frame.intrinsics.height) == (0.001, 0.46, HEIGHT)
            wait_until(lambda: (c := side.counters()) and c.gauges["source_silent_s"] > 1, what="the silence to show")
            running.send_signal(signal.SIGTERM)
            assert running.wait(30) == 0  # within 2 s by its own clock: later, it leaves with 70


@pytest.mark.graph
def test_compressed_depth_bad_messages_and_wrong_topics(link: LinkConfig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ros2_live, "FIRST_WITHIN_S", 0.6)
    topic = f"{TOPIC}/compressedDepth"
    with ros2_session(link) as session:
        camera = Ros2Camera(session, topic, gid=ONE)
        wrong = CameraConfig(source="ros2", topic="/camera/deep/image_raw")
        with pytest.raises(InputError, match=rf"no images on ROS topic /camera/deep.*published there: .*{topic} \("):
            ros2_live.Ros2Source.connect("front", wrong, link)
        with pytest.raises(ConfigError, match="is no ROS topic"):
            ros2_live.Ros2Source.connect("front", CameraConfig(source="ros2", topic="depth image"), link)
        monkeypatch.setattr(ros2_live, "FIRST_WITHIN_S", 20.0)
        stop = threading.Event()

        def keep_publishing() -> None:
            for n in count():
                if stop.wait(0.02):
                    return
                data = compressed_depth(n % 50)
                camera.publish(data[:100] if n % 10 == 9 else data, info())

        thread = threading.Thread(target=keep_publishing)
        thread.start()
        try:
            source = ros2_live.Ros2Source.connect("front", CameraConfig(source="ros2", topic=topic), link)
            frames = source.frames(run="r", after=4)
            items = [next(frames) for _ in range(25)]
            frames.close()
        finally:
            stop.set()
            thread.join()
    assert items[0].seq == 5
    assert [b.seq > a.seq for a, b in pairwise(items)] == [True] * 24
    assert {item.reason for item in items if not isinstance(item, Frame)} == {"undecodable"}
    assert sum(isinstance(item, Frame) for item in items) >= 20
    assert source.description.fps == pytest.approx(30.0, rel=0.01)
