"""ROS 2 topics over Zenoh as a live source, from a publisher that writes the bytes of rmw_zenoh. No ROS was at hand."""

from __future__ import annotations

import signal
import struct
import threading
from itertools import count, cycle, pairwise
from pathlib import Path

import numpy as np
import pytest

from camera_sim.live.rmw_zenoh import Attachment, Numbering, key_of, published_topic, read_attachment
from conveyor.camera_place import CameraPlace
from conveyor.config import CameraConfig, LinkConfig
from conveyor.errors import ConfigError, InputError, MessageError
from conveyor.formats.png16 import Refusal
from conveyor.messages import Frame
from tests.camera_sim.camera_process import RUN, line, other_side, process
from tests.conftest import wait_until

pytest.importorskip("rosbags.typesys")

from camera_sim.live import ros2 as ros2_live
from camera_sim.live.ros2_calibration import DOUBTED_IMAGES, Calibrations
from tests.camera_sim.ros2_publisher import Ros2Camera, ros2_session
from tests.formats.bag_messages import HEIGHT, P, compressed_depth, depth_mm, image, info, stamp_ns

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
    hung = {"belt_distance_m": 0.46, "across_m": 0.3, "turned_deg": 180.0}
    config = line(link, source="ros2", topic=TOPIC, ros_domain=7, **hung)
    pose = CameraPlace(0.0, 0.3, 180.0).straight_down(0.46)
    skips = {12: 3, 20: 1}
    with ros2_session(link) as session, other_side(config) as side:
        camera = Ros2Camera(session, TOPIC, gid=ONE, domain=7)
        got: dict[int, Frame] = {}

        def publish_until(enough: int, numbers: count) -> None:  # type: ignore[type-arg]
            def more() -> bool:
                n = next(numbers)
                camera.publish(image(n % 50, pad=4, stamp=n), info(), skip=skips.pop(len(got), 0))
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
                assert np.array_equal(frame.depth, depth_mm(n % 50))
                assert (frame.depth_scale_m, frame.belt_distance_m, frame.intrinsics.height) == (0.001, 0.46, HEIGHT)
                assert np.array_equal(frame.belt_from_camera, pose), "it hangs where the line's file says"
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


OTHER_P = (2 * P[0], 0.0, P[2], 0.0, 0.0, 2 * P[5], *P[6:])


def calibrations(*said: tuple[int, bytes]) -> Calibrations:
    """The CameraInfos of images n by these publishers, the intrinsics of the second one's others than of the first."""
    found = Calibrations("/camera/camera_info", rectified=True)
    for n, publisher in said:
        found.take(info(n, p=P if publisher == ONE else OTHER_P), attachment(n, publisher))
    return found


def attachment(n: int, gid: bytes) -> bytes:
    return struct.pack("<qqB", n, 0, 16) + gid


def fx_of(found: Calibrations, n: int, publisher: bytes) -> float | str:
    k = found.of_image(stamp_ns(n), publisher=publisher)
    return k.reason if isinstance(k, Refusal) else k.fx


def test_an_image_has_the_intrinsics_that_were_said_of_it() -> None:
    """CameraInfo was read once: what a driver that started again in another mode sent was weighed with old ones."""
    found = calibrations((0, ONE), (1, ONE), (2, TWO))
    assert [fx_of(found, n, ONE) for n in (0, 1, 2, 7)] == [P[0], P[0], 2 * P[0], 2 * P[0]]


def test_images_of_a_driver_that_started_again_wait_for_its_camera_info() -> None:
    found = calibrations((0, ONE))
    assert fx_of(found, 0, b"a") == P[0]
    assert [fx_of(found, n, b"b") for n in (5, 6)] == ["camera_info"] * 2
    found.take(info(7, p=OTHER_P), attachment(1, TWO))
    assert fx_of(found, 7, b"b") == 2 * P[0]
    # A CameraInfo that came before the first image of the next driver holds at once, and one that never comes again
    # is of a node that lives on.
    found.take(info(8), attachment(1, ONE))
    assert fx_of(found, 8, b"c") == P[0]
    said = [fx_of(found, 9 + n, b"d") for n in range(DOUBTED_IMAGES + 1)]
    assert said == ["camera_info"] * DOUBTED_IMAGES + [P[0]]


def test_an_unusable_camera_info_makes_its_images_unusable_until_another_comes() -> None:
    found = calibrations((0, ONE))
    found.take(info(1, k=(0.0,) * 9, p=(0.0,) * 12), attachment(1, ONE))
    assert "not calibrated" in found.of_image(stamp_ns(1), publisher=ONE).text  # type: ignore[union-attr]
    found.take(b"no message", attachment(2, ONE))
    assert fx_of(found, 2, ONE) == "camera_info"
    found.take(info(3), attachment(3, ONE))
    assert fx_of(found, 3, ONE) == P[0]


@pytest.mark.graph
def test_a_view_that_is_blocked_at_the_start_and_a_driver_in_another_mode_end_no_camera(link: LinkConfig) -> None:
    """A hand before the lens was taken for a wrong scale, and ended the camera for good; so did a second node."""
    settings = CameraConfig(source="ros2", topic=TOPIC, belt_distance_m=0.42)
    shapes = list[str]()
    stop = threading.Event()
    with ros2_session(link) as session:
        camera = Ros2Camera(session, TOPIC, gid=ONE)

        def keep_publishing() -> None:
            other: Ros2Camera | None = None
            for n in cycle(range(50)):
                if stop.wait(0.02):
                    return
                clear = len(shapes) > 5
                if len(shapes) > 10 and other is None:
                    other = Ros2Camera(session, TOPIC, gid=TWO)
                sender = other or camera
                p = OTHER_P if other else P
                sender.publish(image(n, nearer_mm=0 if clear else 390), info(n, p=p))
                if n % 10 == 9:
                    camera.publish(image(n), info(n))

        thread = threading.Thread(target=keep_publishing)
        thread.start()
        try:
            frames = ros2_live.Ros2Source.connect("front", settings, link).frames(run="r")
            wanted = {"depth_scale", f"fx {P[0]:g}", f"fx {2 * P[0]:g}", "two_publishers"}

            def next_shape() -> bool:
                item = next(frames)
                shapes.append(f"fx {item.intrinsics.fx:g}" if isinstance(item, Frame) else item.reason)
                return wanted <= set(shapes)

            wait_until(next_shape, what=f"{wanted}; came: {shapes}")
            frames.close()
        finally:
            stop.set()
            thread.join()
    assert shapes[:5] == ["depth_scale"] * 5
