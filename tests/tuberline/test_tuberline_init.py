"""`tuberline init` writes a line's file that is accepted, for what it finds or is given; asked in a terminal."""

from __future__ import annotations

import io
import json
import os
import pty
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from camera_sim.configured import configured_source
from camera_sim.sim.presets import EASY_PRESET
from camera_sim.sim.record import record_scene
from camera_sim.sim.scenes import SceneSettings
from conveyor.config import LinkConfig, load_config
from conveyor.errors import InputError
from tests.camera_sim.ros2_publisher import Ros2Camera, ros2_session
from tests.conftest import wait_until
from tests.small_recordings import SMALL
from tuberline.cli.init import init
from tuberline.setup.found import found_recordings, found_ros2

HERE = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two recordings, one deeper, and things that are none."""
    folder = tmp_path_factory.mktemp("place")
    settings = SceneSettings("touching", seed=3, tubers=1, preset=EASY_PRESET, optics=SMALL, fps=5.0)
    (folder / "recordings").mkdir()
    record_scene(folder / "recordings" / "monday", settings)
    record_scene(folder / "tuesday.mcap", settings)
    (folder / "notes.mcap").write_text("no recording")
    (folder / "photos").mkdir()
    return folder


def test_recordings_near_here_are_found(two: Path) -> None:
    assert sorted(one.words.split(":")[0].split(str(two))[1] for one in found_recordings(two)) == [
        "/recordings/monday",
        "/tuesday.mcap",
    ]


def test_the_resting_level_of_a_recording_stands_in_its_line(
    two: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A replay of the recording took it, the line of `init` did not: it weighed its tubers light."""
    for name, offset_mm in (("one", 5.5), ("other", 2.0)):
        shutil.copytree(two / "recordings" / "monday", tmp_path / name)
        for told in (tmp_path / name).rglob("camera.json"):
            said = json.loads(told.read_text(encoding="utf-8"))
            told.write_text(json.dumps({**said, "resting_offset_mm": offset_mm, "resting_sd_mm": 1.0}))
    init(tmp_path / "a.toml", recording=(tmp_path / "one",))
    belt = load_config(tmp_path / "a.toml").belt
    assert (belt.resting_offset_mm, belt.resting_sd_mm) == (5.5, 1.0)
    init(tmp_path / "b.toml", recording=(tmp_path / "one", tmp_path / "other"))
    assert load_config(tmp_path / "b.toml").belt.resting_offset_mm == 0.0
    assert "state several resting levels" in capsys.readouterr().out


def test_a_recording_becomes_a_line_that_opens_it(two: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = two / "lines" / "north.toml"
    init(file, recording=(two / "recordings" / "monday", two / "tuesday.mcap"), belt_distance_m=0.45)
    assert f"run it: tuberline run {file}" in capsys.readouterr().out
    line = load_config(file)
    assert (line.name, list(line.cameras)) == ("north", ["front", "rear"])
    assert line.aggregator.out == file.parent / "runs" / "north"
    text = file.read_text(encoding="utf-8")
    assert 'path = "../recordings/monday"' in text
    assert max(map(len, text.splitlines())) <= 120
    for camera in line.cameras:
        description = configured_source(line, camera).description
        assert (description.name, description.belt_distance_m) == (camera, 0.45)
    # What stands there as an example is accepted too, once it is taken into use.
    used = "\n".join(
        one.removeprefix("# ") if " = " in one or one == "# [alarms]" else one for one in text.splitlines()
    )
    used = "\n".join(one for one in used.splitlines() if not one.startswith("belt_distance_m = 0.46"))
    (file.parent / "used.toml").write_text(used, encoding="utf-8")
    assert load_config(file.parent / "used.toml").belt.resting_offset_mm == 5.5
    with pytest.raises(InputError, match=r"north\.toml exists; choose another name"):
        init(file, recording=(two / "tuesday.mcap",))


def test_several_without_a_terminal_are_listed_and_nothing_is_written(
    two: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(two)
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    with pytest.raises(InputError, match=r"(?s)found 2 sources.*1  recording .*2  recording "):
        init(two / "x.toml")
    assert not (two / "x.toml").exists()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="no RealSense camera and no recording is found here; name one"):
        init(tmp_path / "x.toml")
    with pytest.raises(InputError, match=r"ends in \.toml"):
        init(tmp_path / "x")
    with pytest.raises(InputError, match="--recording and --realsense: give one of them"):
        init(tmp_path / "x.toml", recording=(two,), realsense=True)


def test_it_asks_in_a_terminal(two: Path, tmp_path: Path) -> None:
    ours, theirs = pty.openpty()
    file = tmp_path / "asked.toml"
    process = subprocess.Popen(
        [sys.executable, "-m", "tuberline", "init", str(file)],
        cwd=two, env={**os.environ, "PYTHONPATH": str(HERE.parent)}, stdin=theirs, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    os.close(theirs)
    time.sleep(0.1)  # what is typed early waits in the terminal
    os.write(ours, b"9\n2\n")
    _, told = process.communicate(timeout=90)
    os.close(ours)
    assert process.returncode == 0, told
    assert "numbers from 1 to 2" in told
    assert load_config(file).cameras["front"].source == "recording"


def test_connected_cameras_and_their_serial_numbers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "device").mkdir()
    env = {
        **os.environ,
        "REALSENSE_STAND_IN": str(tmp_path / "device"),
        "PYTHONPATH": os.pathsep.join([str(HERE / "camera_sim" / "realsense"), str(HERE.parent)]),
    }
    command = [sys.executable, "-m", "tuberline", "init", "n.toml", "--realsense", "--belt-distance-m", "0.46"]
    done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, check=False, timeout=90)
    assert done.returncode == 0, done.stderr
    camera = load_config(tmp_path / "n.toml").cameras["front"]
    assert (camera.source, camera.serial, camera.belt_distance_m) == ("realsense", "123622270001", 0.46)


@pytest.mark.graph
def test_depth_topics_of_a_ros_system(link: LinkConfig, tmp_path: Path) -> None:
    with ros2_session(link) as session:
        topics = ("/rear/depth/image_rect_raw", "/rear/color/image_raw")
        cameras = [Ros2Camera(session, topic, gid=topic.encode()[:16]) for topic in topics]
        wait_until(lambda: found_ros2(link.router, 0), what="the router knows of both topics")
        init(tmp_path / "ros.toml", ros_router=link.router, belt_distance_m=0.46)
        for one in cameras:
            one.stop()
    ((name, camera),) = load_config(tmp_path / "ros.toml").cameras.items()
    assert (name, camera.topic, camera.ros_router) == ("rear", "/rear/depth/image_rect_raw", link.router)
