"""RealSense settings: checked against what the device offers, set, read back and told; the SDK's own recording read.

The stand-in for the SDK's module has the options of a D405. Where the real SDK is installed (extra `realsense`), the
recording that it wrote is played by it too, so that names and units are those of the SDK.
"""

from __future__ import annotations

import importlib.util
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from camera_sim.live.realsense import RealSenseSource
from camera_sim.live.realsense_options import apply, check_stream, depth_filters
from conveyor.config import parse_config
from conveyor.config_camera import CameraConfig
from conveyor.config_realsense import RealSenseConfig
from conveyor.errors import ConfigError, InputError
from conveyor.formats import open_source
from conveyor.formats.inspection import inspect_recording
from conveyor.messages import Frame

STAND_IN = Path(__file__).parent / "realsense" / "pyrealsense2.py"


@pytest.fixture
def device(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Any, Path]:
    """The stand-in's module, and the folder of its commands."""
    monkeypatch.setenv("REALSENSE_STAND_IN", str(tmp_path))
    spec = importlib.util.spec_from_file_location("stand_in", STAND_IN)
    assert spec is not None
    assert spec.loader is not None
    library = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(library)
    return library, tmp_path


def opened(library: Any, **settings: Any) -> RealSenseSource:
    """A source on the stand-in, started."""
    source = RealSenseSource("front", CameraConfig(source="realsense", realsense=RealSenseConfig(**settings)), library)
    source._description = source._open()
    return source


def asked(folder: Path) -> list[str]:
    """What the device was asked for."""
    return (folder / "asked").read_text().splitlines() if (folder / "asked").exists() else []


def test_settings_are_set_in_order_read_back_and_told(device: tuple[Any, Path]) -> None:
    library, folder = device
    source = opened(library, fps=15, exposure_us=8000, gain=32, preset="high-accuracy")
    # The preset comes first: it would undo what is set before it.
    assert asked(folder) == ["option 1 3", "option 2 0", "option 3 8000", "option 4 32", "start"]
    assert source.description.origin.endswith(": 848x480 at 15/s, preset high-accuracy, exposure 8000 us, gain 32")
    assert source.description.fps == 15
    assert source.description.origin.startswith(f"RealSense {source.description.serial} ")


def test_what_is_not_given_stays_as_the_device_has_it(device: tuple[Any, Path]) -> None:
    library, folder = device
    source = opened(library)
    assert asked(folder) == ["start"]
    assert source.description.origin.endswith(": 848x480 at 30/s, preset default, exposure automatic")


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (
            {"width": 640},
            r"no depth of 640x480 at 30 frames/s; it offers 848x480 at 15, 30, 60; 1280x720 at 15, 30\. Set",
        ),
        ({"fps": 90}, r"no depth of 848x480 at 90 frames/s"),
        ({"laser": True}, "this device has no laser to set; remove it"),
        ({"exposure_us": 200_000}, "exposure_us is 200000; this device takes 1 to 165000 in steps of 1"),
        ({"gain": 8}, "gain is 8; this device takes 16 to 248"),
    ],
)
def test_what_the_device_does_not_offer_is_refused(
    settings: dict[str, Any], words: str, device: tuple[Any, Path]
) -> None:
    library, folder = device
    with pytest.raises(InputError, match=words):
        opened(library, **settings)
    assert "start" not in asked(folder)


def test_a_value_that_the_device_does_not_keep_is_refused(device: tuple[Any, Path]) -> None:
    library, folder = device
    (folder / "stubborn").touch()
    with pytest.raises(InputError, match="exposure_us was set to 5000 and the device keeps 33000"):
        opened(library, exposure_us=5000)


@pytest.mark.parametrize("color", [False, True])
def test_colour_is_aligned_only_where_it_is_used(color: bool, device: tuple[Any, Path]) -> None:
    library, folder = device
    source = opened(library, color=color, filters=("spatial", "hole-filling"))
    (frame,) = islice(source.frames(run="r"), 1)
    assert isinstance(frame, Frame)
    assert asked(folder).count("filtered") == 4, "to disparity, spatial, back, hole-filling"
    assert ("aligned" in asked(folder)) is color
    if not color:
        assert frame.color_jpeg is None
        return
    assert frame.color_jpeg is not None
    picture = cv2.imdecode(frame.color_jpeg, cv2.IMREAD_COLOR)
    assert picture is not None
    assert np.abs(picture.astype(int) - (10, 60, 200)).max() < 8


def test_the_config_refuses_them_for_other_sources_and_names_keys() -> None:
    wrong = {"cameras": {"front": {"source": "ros2", "topic": "/a", "realsense": {"fps": 15}}}}
    with pytest.raises(ConfigError, match="a section realsense is for source = 'realsense'; the source is 'ros2'"):
        parse_config(wrong, where="test")
    wrong = {"cameras": {"front": {"source": "realsense", "realsense": {"exposure": 8000}}}}
    with pytest.raises(ConfigError, match="unknown key; did you mean 'exposure_us'"):
        parse_config(wrong, where="test")


@pytest.fixture
def bag(shared: Path) -> Path:
    """A recording that the SDK itself wrote: a D435, two depth frames."""
    path = shared / "data" / "realsense_sdk_bag" / "single_depth_color_640x480.bag"
    if not path.is_file():
        pytest.skip(f"the SDK's recording is not at {path}")
    return path


def test_the_recording_of_the_sdk_is_read_with_its_unit(bag: Path) -> None:
    pytest.importorskip("rosbags")
    (camera,) = inspect_recording(bag).cameras
    assert (camera.width, camera.height, camera.frames, camera.depth_scale_m) == (640, 480, 2, 0.001)
    first, second = open_source(bag).frames(run="test")
    assert isinstance(first, Frame)
    assert isinstance(second, Frame)
    assert first.intrinsics.fx == pytest.approx(390.431, abs=1e-3)
    assert np.median(first.depth[first.depth > 0]) == 1471


def test_the_sdk_itself_agrees_with_what_we_read_and_set(bag: Path) -> None:
    rs = pytest.importorskip("pyrealsense2", reason="the SDK is not installed: extra `realsense`")
    pytest.importorskip("rosbags")
    config = rs.config()
    config.enable_device_from_file(str(bag), repeat_playback=True)
    pipeline = rs.pipeline()
    profile = pipeline.start(config)
    try:
        device = profile.get_device()
        device.as_playback().set_real_time(False)
        check_stream(rs, device, RealSenseConfig(width=640, height=480, fps=6), camera="front")
        with pytest.raises(InputError, match=r"no depth of 848x480 at 30 frames/s; it offers 640x480 at 6\."):
            check_stream(rs, device, RealSenseConfig(), camera="front")
        sensor = device.first_depth_sensor()
        assert "laser on 150 mW" in apply(rs, sensor, RealSenseConfig(), camera="front")
        taken = pipeline.wait_for_frames(5000).get_depth_frame()
        theirs = np.array(taken.get_data(), np.uint16)
        for one in depth_filters(rs, RealSenseConfig(filters=("spatial", "temporal", "hole-filling"))):
            taken = one.process(taken)
        filtered = np.array(taken.get_data())
    finally:
        pipeline.stop()
    ours = [frame.depth for frame in open_source(bag).frames(run="test") if isinstance(frame, Frame)]
    assert any(np.array_equal(theirs, depth) for depth in ours)
    assert filtered.shape == theirs.shape
    assert np.mean(filtered > 0) > np.mean(theirs > 0), "holes were filled"
