"""ROS 1 and ROS 2 bags as sources, written here with the same library's writers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from conveyor.errors import InputError
from conveyor.formats import Refused, describe_recording, open_source
from conveyor.formats.conversion import convert_recording
from conveyor.messages import Frame

rosbags = pytest.importorskip("rosbags.typesys")

WIDTH, HEIGHT, START_NS, STEP_NS = 32, 24, 1_700_000_000_000_000_000, 33_333_333


def _depth(n: int) -> np.ndarray:
    return (np.arange(WIDTH * HEIGHT, dtype=np.uint16).reshape(HEIGHT, WIDTH) % 50 + 400 + n).astype(np.uint16)


def _image(types: dict[str, Any], n: int, *, ros1: bool, encoding: str = "16UC1") -> Any:
    stamp_ns = START_NS + n * STEP_NS
    time = types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    header = {"stamp": time, "frame_id": "depth"} | ({"seq": n} if ros1 else {})
    step = 2 * WIDTH + 6  # rows may be padded
    rows = np.zeros((HEIGHT, step), np.uint8)
    rows[:, : 2 * WIDTH] = _depth(n).view(np.uint8).reshape(HEIGHT, 2 * WIDTH)
    return types["sensor_msgs/msg/Image"](
        header=types["std_msgs/msg/Header"](**header),
        height=HEIGHT,
        width=WIDTH,
        encoding=encoding,
        is_bigendian=0,
        step=step,
        data=rows.ravel(),
    )


def _info(types: dict[str, Any], *, ros1: bool) -> Any:
    time = types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    header = {"stamp": time, "frame_id": "depth"} | ({"seq": 0} if ros1 else {})
    names = ("D", "K", "R", "P") if ros1 else ("d", "k", "r", "p")
    matrices = (np.zeros(5), np.array([30.0, 0, 15.5, 0, 31.0, 11.5, 0, 0, 1]), np.eye(3).ravel(), np.zeros(12))
    roi = types["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    return types["sensor_msgs/msg/CameraInfo"](
        header=types["std_msgs/msg/Header"](**header),
        height=HEIGHT,
        width=WIDTH,
        distortion_model="plumb_bob",
        binning_x=0,
        binning_y=0,
        roi=roi,
        **dict(zip(names, matrices, strict=True)),
    )


def _ros2(path: Path, *, mcap: bool, topics: tuple[str, ...] = ("/front/depth", "/rear/depth")) -> Path:
    from rosbags.rosbag2 import StoragePlugin, Writer

    store = rosbags.get_typestore(rosbags.Stores.ROS2_HUMBLE)
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        for topic in topics:
            images = writer.add_connection(f"{topic}/image_rect_raw", "sensor_msgs/msg/Image", typestore=store)
            infos = writer.add_connection(f"{topic}/camera_info", "sensor_msgs/msg/CameraInfo", typestore=store)
            writer.write(infos, START_NS, store.serialize_cdr(_info(store.types, ros1=False), infos.msgtype))
            for n in range(5):
                encoding = "rgb8" if n == 3 else "16UC1"
                data = store.serialize_cdr(_image(store.types, n, ros1=False, encoding=encoding), images.msgtype)
                writer.write(images, START_NS + n * STEP_NS + 5_000, data)
    return path


def _ros1(path: Path, *, unit_m: float | None) -> Path:
    from rosbags.rosbag1 import Writer

    store = rosbags.get_typestore(rosbags.Stores.ROS1_NOETIC)
    base = "/device_0/sensor_0"
    with Writer(path) as writer:
        images = writer.add_connection(f"{base}/Depth_0/image/data", "sensor_msgs/msg/Image", typestore=store)
        infos = writer.add_connection(f"{base}/Depth_0/info/camera_info", "sensor_msgs/msg/CameraInfo", typestore=store)
        writer.write(infos, START_NS, store.serialize_ros1(_info(store.types, ros1=True), infos.msgtype))
        if unit_m is not None:
            units = writer.add_connection(f"{base}/option/Depth_Units/value", "std_msgs/msg/Float32", typestore=store)
            value = store.types["std_msgs/msg/Float32"](data=unit_m)
            writer.write(units, START_NS, store.serialize_ros1(value, units.msgtype))
        for n in range(4):
            data = store.serialize_ros1(_image(store.types, n, ros1=True, encoding="mono16"), images.msgtype)
            writer.write(images, START_NS + n * STEP_NS, data)
    return path


@pytest.mark.parametrize("mcap", [False, True])
def test_a_ros2_bag_gives_its_depth_by_camera(tmp_path: Path, mcap: bool) -> None:
    bag = _ros2(tmp_path / "bag", mcap=mcap)
    cameras = describe_recording(bag).cameras
    assert [(c.name, c.frames, c.depth_scale_m) for c in cameras] == [("front", 5, 0.001), ("rear", 5, 0.001)]
    k = cameras[0].intrinsics
    assert (k.width, k.height, k.fx, k.fy, k.cx, k.cy) == (WIDTH, HEIGHT, 30.0, 31.0, 15.5, 11.5)
    assert cameras[0].fps == pytest.approx(30.0, rel=1e-3)
    items = list(open_source(bag, camera="rear", name="r", belt_distance_m=0.43).frames(run="x"))
    assert [item.seq for item in items] == [0, 1, 2, 3, 4]
    assert isinstance(items[3], Refused)
    assert "encoding 'rgb8'" in items[3].text
    for n in (0, 1, 2, 4):
        frame = items[n]
        assert isinstance(frame, Frame)
        assert np.array_equal(frame.depth, _depth(n))
        assert (frame.camera, frame.captured_ns, frame.belt_distance_m) == ("r", START_NS + n * STEP_NS, 0.43)


def test_the_file_inside_a_bags_folder_will_do(tmp_path: Path) -> None:
    for name, mcap in (("a", True), ("b", False)):
        folder = _ros2(tmp_path / name, mcap=mcap, topics=("/belt/depth",))
        file = next(path for path in folder.iterdir() if path.suffix in (".mcap", ".db3"))
        assert [camera.name for camera in describe_recording(file).cameras] == ["belt"]


@pytest.mark.parametrize(("unit_m", "scale"), [(0.0001, 0.0001), (None, 0.001)])
def test_a_realsense_bag_tells_its_depth_unit(tmp_path: Path, unit_m: float | None, scale: float) -> None:
    source = open_source(_ros1(tmp_path / "rs.bag", unit_m=unit_m))
    assert source.description.name == "device_0-sensor_0"
    assert source.description.depth_scale_m == pytest.approx(scale, rel=1e-6)
    first, last = source.frames(run="x", after=1)
    assert isinstance(first, Frame)
    assert (first.seq, last.seq) == (2, 3)
    assert np.array_equal(first.depth, _depth(2))


@pytest.mark.parametrize("unit_m", [0.0, -0.001, 1.0, float("nan")])
def test_a_unit_that_no_camera_has_is_refused(tmp_path: Path, unit_m: float) -> None:
    with pytest.raises(InputError, match=r"says that a unit of depth is .* m; allowed is above 0 to 0\.01"):
        open_source(_ros1(tmp_path / "rs.bag", unit_m=unit_m))


def test_a_bag_becomes_our_mcap(tmp_path: Path) -> None:
    bag = _ros2(tmp_path / "bag", mcap=False)
    done = convert_recording(bag, tmp_path / "ours.mcap", belt_distance_m=0.43)
    assert (done.frames, done.refused) == (8, {"encoding": 2})
    back = list(open_source(tmp_path / "ours.mcap", camera="front").frames(run="x"))
    assert [frame.seq for frame in back] == [0, 1, 2, 4]
    assert all(isinstance(frame, Frame) and frame.belt_distance_m == 0.43 for frame in back)


def test_a_bag_without_depth_lists_its_topics(tmp_path: Path) -> None:
    bag = _ros2(tmp_path / "bag", mcap=False, topics=("/front/color",))
    with pytest.raises(InputError, match=r"no depth image topic.*/front/color/image_rect_raw"):
        open_source(bag)


def test_a_broken_bag_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.bag").write_bytes(b"#ROSBAG V2.0\nnonsense")
    with pytest.raises(InputError, match=r"x\.bag is no ROS bag that can be read"):
        open_source(tmp_path / "x.bag")


def test_a_count_of_messages_that_is_no_number_is_damage(tmp_path: Path) -> None:
    about = _ros2(tmp_path / "bag", mcap=False) / "metadata.yaml"
    about.write_text(about.read_text().replace("message_count: 5", "message_count:"))
    with pytest.raises(InputError, match=r"bag is damaged, and cannot be read as a ROS bag: TypeError"):
        open_source(tmp_path / "bag")
