"""Depth in every form that ROS and Foxglove bags have it, and what is said of bags without."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conveyor.errors import InputError, MessageError
from conveyor.formats import Refused, camera_names, open_source
from conveyor.formats.conversion import convert_recording
from conveyor.formats.inspection import inspect_recording
from conveyor.formats.rosbag.bags import decode_ros, open_bag
from conveyor.formats.rosbag.foxglove import from_json, from_protobuf
from conveyor.formats.rosbag.messages import Kind
from conveyor.formats.rosbag.streams import depth_streams
from conveyor.messages import Frame

pytest.importorskip("rosbags.typesys")

from tests.formats.bag_messages import (
    COMPRESSED,
    HEIGHT,
    IMAGE,
    INFO,
    WIDTH,
    compressed_depth,
    depth_mm,
    foxglove_compressed,
    foxglove_json,
    foxglove_protobuf,
    image,
    info,
    stamp_ns,
    write_mcap,
)

DEPTH, DEPTH_INFO = "/camera/camera/depth/image_rect_raw", "/camera/camera/depth/camera_info"
ALIGNED = "/camera/camera/aligned_depth_to_color/image_raw"


def _frames(path: Path, **options: object) -> list[Frame | Refused]:
    return list(open_source(path, **options).frames(run="x"))  # type: ignore[arg-type]


def _bag(path: Path, images: list[bytes], *, kind: str = IMAGE, topic: str = DEPTH) -> Path:
    return write_mcap(path / "bag.mcap", {topic: (kind, "cdr", images), DEPTH_INFO: (INFO, "cdr", [info()])})


@pytest.mark.parametrize("encoding", ["16UC1", "mono16", "32FC1"])
@pytest.mark.parametrize(("pad", "big_endian"), [(0, False), (6, False), (2, True)])
def test_depth_is_the_same_in_every_encoding(tmp_path: Path, encoding: str, pad: int, big_endian: bool) -> None:
    images = [image(n, encoding=encoding, pad=pad, big_endian=big_endian) for n in range(3)]
    for n, frame in enumerate(_frames(_bag(tmp_path, images))):
        assert isinstance(frame, Frame)
        assert np.array_equal(np.round(frame.depth * frame.depth_scale_m * 1000).astype(int), depth_mm(n))
        assert frame.depth_scale_m == (0.0001 if encoding == "32FC1" else 0.001)
        assert (frame.seq, frame.captured_ns) == (n, stamp_ns(n))
        k = frame.intrinsics
        assert (k.fx, k.fy, k.cx, k.cy) == (29.0, 30.5, 15.0, 11.0)  # a rectified image has the projection matrix


FORMS = [f"{pixels}; compressedDepth{how}" for pixels in ("16UC1", "32FC1") for how in (" png", "", " rvl")]


@pytest.mark.parametrize("form", FORMS)
def test_compressed_depth_is_read(tmp_path: Path, form: str) -> None:
    topic = f"{DEPTH}/compressedDepth"
    path = _bag(tmp_path, [compressed_depth(n, form=form) for n in range(2)], kind=COMPRESSED, topic=topic)
    for n, frame in enumerate(_frames(path)):
        assert isinstance(frame, Frame)
        seen_mm = frame.depth * frame.depth_scale_m * 1000
        assert np.array_equal(frame.depth > 0, depth_mm(n) > 0)
        # float depth is quantised by the transport: a step is z^2 / a = 0.02 mm here
        np.testing.assert_allclose(seen_mm, depth_mm(n), atol=0.11 if form.startswith("32") else 0)


def test_a_plain_16_bit_png_is_depth_and_a_jpeg_of_depth_is_not(tmp_path: Path) -> None:
    topic = "/front/depth/image/compressed"
    png = _bag(tmp_path, [compressed_depth(1, form="16UC1; png compressed ")], kind=COMPRESSED, topic=topic)
    with pytest.raises(InputError, match="no CameraInfo"):  # of another camera
        open_source(png)
    channels = {topic: (COMPRESSED, "cdr", [compressed_depth(1, form="16UC1; png compressed ")])}
    good = write_mcap(tmp_path / "good.mcap", {**channels, "/front/camera_info": (INFO, "cdr", [info()])})
    assert np.array_equal(_frames(good)[0].depth, depth_mm(1))  # type: ignore[union-attr]
    channels = {topic: (COMPRESSED, "cdr", [compressed_depth(1, form="16UC1; jpeg compressed ")])}
    bad = write_mcap(tmp_path / "bad.mcap", {**channels, "/front/camera_info": (INFO, "cdr", [info()])})
    with pytest.raises(InputError, match="no depth image topic"):
        open_source(bad)


def test_one_of_a_cameras_depth_topics_is_taken_and_the_others_are_named(tmp_path: Path) -> None:
    aligned = [image(n + 100) for n in range(2)]
    path = write_mcap(
        tmp_path / "bag.mcap",
        {
            ALIGNED: (IMAGE, "cdr", aligned),
            "/camera/camera/aligned_depth_to_color/camera_info": (INFO, "cdr", [info()]),
            f"{DEPTH}/compressedDepth": (COMPRESSED, "cdr", [compressed_depth(0)]),
            DEPTH: (IMAGE, "cdr", [image(n) for n in range(2)]),
            DEPTH_INFO: (INFO, "cdr", [info()]),
            "/camera/camera/color/image_raw": (IMAGE, "cdr", [image(0, encoding="rgb8")]),
            "/camera/camera/infra1/image_rect_raw": (IMAGE, "cdr", [image(0, encoding="mono16")]),
        },
    )
    assert camera_names(path) == ("camera",)
    assert np.array_equal(_frames(path)[1].depth, depth_mm(1))  # type: ignore[union-attr]
    warnings = inspect_recording(path).cameras[0].warnings
    assert any(ALIGNED in text and "compressedDepth" in text for text in warnings)
    assert np.array_equal(_frames(path, camera=ALIGNED)[1].depth, depth_mm(101))  # type: ignore[union-attr]
    with pytest.raises(InputError, match=r"has no topic /nowhere; its topics: .*/camera/camera/depth/camera_info"):
        open_source(path, camera="/nowhere")


def test_depth_is_found_by_its_encoding_where_no_topic_is_named_after_it(tmp_path: Path) -> None:
    path = write_mcap(
        tmp_path / "bag.mcap",
        {
            "/belt/left/range": (IMAGE, "cdr", [image(0)]),
            "/belt/left/camera_info": (INFO, "cdr", [info()]),
            "/belt/left/grey": (IMAGE, "cdr", [image(0, encoding="mono16")]),
        },
    )
    assert camera_names(path) == ("belt-left",)


@pytest.mark.parametrize("encoding", ["json", "protobuf"])
def test_foxglove_images_are_read(tmp_path: Path, encoding: str) -> None:
    make = foxglove_json if encoding == "json" else foxglove_protobuf
    path = write_mcap(
        tmp_path / "bag.mcap",
        {
            "/front/depth": ("foxglove.RawImage", encoding, [make(n)[0] for n in range(3)]),
            "/front/calibration": ("foxglove.CameraCalibration", encoding, [make(0)[1]]),
            "/rear/depth": ("foxglove.CompressedImage", encoding, [foxglove_compressed(n, encoding) for n in range(2)]),
            "/rear/calibration": ("foxglove.CameraCalibration", encoding, [make(0)[1]]),
        },
        profile="",
    )
    frames = _frames(path, camera="front")
    assert [(f.seq, f.captured_ns) for f in frames] == [(n, stamp_ns(n)) for n in range(3)]  # type: ignore[union-attr]
    assert all(np.array_equal(f.depth, depth_mm(n)) for n, f in enumerate(frames))  # type: ignore[union-attr]
    assert frames[0].intrinsics.fx == 30.0  # type: ignore[union-attr]
    rear = _frames(path, camera="rear")
    assert all(np.array_equal(f.depth, depth_mm(n)) for n, f in enumerate(rear))  # type: ignore[union-attr]
    assert len(rear) == 2


@given(st.binary(max_size=60), st.sampled_from(["image", "compressed", "calibration"]), st.booleans())
@settings(max_examples=300, deadline=None)
def test_any_bytes_are_a_foxglove_message_or_an_error_of_ours(data: bytes, kind: Kind, cut: bool) -> None:
    whole = foxglove_protobuf(0)[kind == "calibration"]
    for encoded, decode in ((whole[: len(data)] + data if cut else data, from_protobuf), (data, from_json)):
        with suppress(MessageError):
            decode(kind, encoded)


def test_ros_1_messages_in_mcap_are_read(tmp_path: Path) -> None:
    path = write_mcap(
        tmp_path / "bag.mcap",
        {
            "/front/depth/image": ("sensor_msgs/Image", "ros1", [image(n, ros1=True) for n in range(2)]),
            "/front/depth/camera_info": ("sensor_msgs/CameraInfo", "ros1", [info(ros1=True)]),
        },
        profile="ros1",
    )
    assert [f.captured_ns for f in _frames(path)] == [stamp_ns(0), stamp_ns(1)]  # type: ignore[union-attr]


def test_a_broken_message_is_refused_by_its_number_and_the_rest_goes_on(tmp_path: Path) -> None:
    images = [image(0), image(1)[:200], image(2)[:-40], image(3, encoding="32FC1"), image(4)]
    items = _frames(_bag(tmp_path, images))
    assert [item.seq for item in items] == [0, 1, 2, 3, 4]
    refused = {item.seq: item.reason for item in items if isinstance(item, Refused)}
    assert refused == {1: "undecodable", 2: "undecodable", 3: "encoding"}


@pytest.mark.parametrize(
    ("topic", "reasons"), [(DEPTH, ["undecodable", "encoding"]), ("/camera/range", ["undecodable"])]
)
def test_a_bag_whose_first_messages_are_damaged_lacks_those_frames(tmp_path: Path, topic: str, reasons: list) -> None:
    """It was refused whole, while the same damage further on was one frame that is missing."""
    damaged = {"undecodable": image(0)[:200], "encoding": image(0, encoding="\x7fUC1")}
    images = [*(damaged[reason] for reason in reasons), image(7)]
    infos = [info()[:60], info()]
    channels = {topic: (IMAGE, "cdr", images), "/camera/camera_info": (INFO, "cdr", infos)}
    *refused, frame = _frames(write_mcap(tmp_path / "bag.mcap", channels))
    assert [item.reason for item in refused if isinstance(item, Refused)] == reasons
    assert isinstance(frame, Frame)
    assert (frame.seq, frame.depth_scale_m, np.array_equal(frame.depth, depth_mm(7))) == (len(reasons), 0.001, True)


def test_a_frame_that_no_recording_can_hold_is_left_out_of_one_and_told(tmp_path: Path) -> None:
    """A time before 1970 ended the conversion as a fault of the program, or made a folder that could not be read."""
    bag = _bag(tmp_path, [image(0), image(1, stamp=-55_000_000_000), image(2)])
    for target in ("r.mcap", "r"):
        done = convert_recording(bag, tmp_path / target)
        assert (done.frames, done.refused) == (2, {"out_of_range": 1})
        assert "frame 1 of camera: Frame.captured_ns: must be at least 0 ns" in done.texts[0]
        assert [frame.seq for frame in _frames(tmp_path / target)] == [0, 2]
    channels = {DEPTH: (IMAGE, "cdr", [image(0)]), DEPTH_INFO: (INFO, "cdr", [info()])}
    broken = {"/rear/depth/compressedDepth": (COMPRESSED, "cdr", [b"no image"])}
    with pytest.raises(InputError, match=r"no message on /rear/depth/compressedDepth can be decoded; the first: "):
        open_source(write_mcap(tmp_path / "bag.mcap", channels | broken))


def test_every_cut_of_a_message_is_an_error_of_ours() -> None:
    data = image(0)
    assert decode_ros(IMAGE, data).width == WIDTH  # type: ignore[union-attr]
    for length in (0, 3, 4, 11, 20, 43, 60, len(data) // 2):
        with pytest.raises(MessageError, match="sensor_msgs/msg/Image cannot be decoded"):
            decode_ros(IMAGE, data[:length])


@pytest.mark.parametrize(
    ("channels", "text"),
    [
        (
            {DEPTH: (IMAGE, "cdr", [image(0)])},
            r"no CameraInfo topic beside it.*Record /camera/camera/depth/camera_info",
        ),
        (
            {DEPTH: (IMAGE, "cdr", [image(0)]), "/other/camera_info": (INFO, "cdr", [info()])},
            r"no CameraInfo topic beside it.*camera infos there are: /other/camera_info",
        ),
        (
            {DEPTH: (IMAGE, "cdr", [image(0)]), "/camera/camera/color/camera_info": (INFO, "cdr", [info()])},
            r"no CameraInfo topic beside it.*camera infos there are: /camera/camera/color/camera_info",
        ),
        (
            {DEPTH: (IMAGE, "cdr", [image(0, encoding="8UC1")]), DEPTH_INFO: (INFO, "cdr", [info()])},
            r"has encoding '8UC1'; depth is read from 16UC1, mono16, Z16, 32FC1 \(metres\), compressedDepth png or rvl",
        ),
        (
            {DEPTH: (IMAGE, "cdr", [image(0)]), DEPTH_INFO: (INFO, "cdr", [info(k=(0.0,) * 9)[:-200]])},
            r"no message on .*camera_info can be decoded; the first: ",
        ),
        (
            {
                "/camera/color/image_raw": (IMAGE, "cdr", [image(0, encoding="rgb8")]),
                "/tf": ("tf2/msg/Tf", "cdr", [b""]),
            },
            r"no depth image topic.*its topics: /camera/color/image_raw \(sensor_msgs/msg/Image\), /tf \(tf2/msg/Tf\)",
        ),
    ],
)
def test_what_a_bag_lacks_is_said(tmp_path: Path, channels: dict, text: str) -> None:
    with pytest.raises(InputError, match=text):
        open_source(write_mcap(tmp_path / "bag.mcap", channels), camera="camera")


@pytest.mark.parametrize(
    ("depth", "beside", "taken"),
    [
        ("/camera/depth/image_rect_raw", ("color", "infra1"), "infra1"),
        ("/camera/aligned_depth_to_color/image_raw", ("color",), "color"),
        ("/camera/depth_registered/image_raw", ("rgb",), "rgb"),
    ],
)
def test_intrinsics_are_of_the_lens_that_saw_the_depth(
    tmp_path: Path, depth: str, beside: tuple[str, ...], taken: str
) -> None:
    """Those of the colour camera, 1.6 times as long, made two thirds of a load vanish."""
    infos = {f"/camera/{name}/camera_info": (INFO, "cdr", [info()]) for name in beside}
    path = write_mcap(tmp_path / "bag.mcap", {depth: (IMAGE, "cdr", [image(0)]), **infos})
    with open_bag(path) as bag:
        (stream,) = depth_streams(path, bag)
    assert stream.info == f"/camera/{taken}/camera_info"


def test_an_image_that_is_not_rectified_has_its_own_matrix_and_a_warning(tmp_path: Path) -> None:
    raw = "/camera/depth/image_raw"
    path = write_mcap(
        tmp_path / "bag.mcap",
        {raw: (IMAGE, "cdr", [image(0)]), "/camera/depth/camera_info": (INFO, "cdr", [info(distortion=0.1)])},
    )
    d = open_source(path).description
    assert (d.intrinsics.fx, d.intrinsics.height) == (30.0, HEIGHT)
    assert any("distortion" in note for note in d.notes)
