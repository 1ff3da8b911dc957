"""A camera of a folder recording is called as its folder is; what a line cannot be called is refused before it runs."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import tuberline
from conveyor.config_camera import CameraConfig
from conveyor.errors import InputError
from conveyor.formats import camera_names, describe_recording
from conveyor.formats.cameras import check_readable, open_cameras
from conveyor.formats.conversion import convert_recording
from conveyor.formats.folder.reader import FolderSource
from conveyor.formats.folder.writer import FolderWriter
from conveyor.formats.inspection import inspect_recording
from conveyor.formats.source import CameraDescription
from conveyor.geometry import Intrinsics, straight_down_belt_from_camera
from conveyor.messages import Frame
from tuberline.cli.recordings import convert
from tuberline.places import hung_together
from tuberline.replayer import replay_recording

K = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
FRAMES = 4


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """One camera, 'front', over a bare belt at 0.46 m."""
    told = CameraDescription("front", "t", K, 0.001, 0.46, None, 30.0, FRAMES)
    with FolderWriter(tmp_path / "r", told) as writer:
        for seq in range(FRAMES):
            depth = np.full((48, 64), 460, np.uint16)
            writer.write(Frame("front", "r", seq, seq * 33_000_000, None, 0.001, K, 0.46, depth))
    return tmp_path / "r"


def edit(recording: Path, **changes: Any) -> None:
    path = recording / "front" / "camera.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


def test_two_cameras_whose_files_say_one_name_are_two(recorded: Path, tmp_path: Path) -> None:
    """A camera.json that was copied: `convert` wrote both cameras' frames over one another and said nothing."""
    shutil.copytree(recorded / "front", recorded / "rear")
    for target in (tmp_path / "out.mcap", tmp_path / "out"):
        assert convert_recording(recorded, target).frames == 2 * FRAMES
        cameras = inspect_recording(target).cameras
        assert [(camera.name, camera.frames, camera.gaps) for camera in cameras] == [
            ("front", FRAMES, 0),
            ("rear", FRAMES, 0),
        ]
    assert inspect_recording(recorded).cameras[1].warnings == (
        "camera.json names it 'front': it is called 'rear', as its folder is",
    )


def test_the_names_that_a_recording_lists_are_those_it_takes(recorded: Path) -> None:
    """A camera.json with a serial number for a name: that was listed, and refused when it was asked for."""
    edit(recorded, name="123622270136")
    opened = tuberline.open_recording(recorded)
    assert [camera.name for camera in opened.cameras] == ["front"]
    assert [frame.camera for frame in opened.frames("front")] == ["front"] * FRAMES


def test_a_camera_over_a_belt_along_its_columns_is_described_as_its_frames_are(recorded: Path) -> None:
    """Frames come turned by a quarter; intrinsics and pose of `cameras` were those of the image as recorded."""
    pose = straight_down_belt_from_camera(0.46)
    pose[:2, :2] = [[1, 0], [0, -1]]
    edit(recorded, belt_from_camera=pose.tolist())
    opened = tuberline.open_recording(recorded)
    frame = next(opened.frames())
    assert frame.depth.shape == (K.width, K.height)
    assert opened.cameras[0].intrinsics == frame.intrinsics
    assert np.array_equal(opened.cameras[0].belt_from_camera, frame.belt_from_camera)


def test_a_camera_folder_may_be_the_current_one(recorded: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It was refused for its camera's name ''."""
    monkeypatch.chdir(recorded / "front")
    assert camera_names(Path()) == ("front",)
    assert describe_recording(Path()).cameras[0].name == "front"


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ('{"cameras": "front"}', r"with the name of each camera's folder, got 'front'"),
        ('{"cameras": []}', r"got '\[\]'; correct it, or remove it"),
        ('{"cameras": [1]}', r"got '\[1\]'"),
        ('{"cameras": ["front", "front"]}', r"got .*'front', 'front'"),
        ("[]", r"got '\[\]'"),
        ('{"cameras":', r"is not JSON: Expecting value"),
    ],
)
def test_a_line_file_that_names_no_cameras_is_refused_with_what_it_must_read(
    recorded: Path, line: str, said: str
) -> None:
    (recorded / "line.json").write_text(line)
    with pytest.raises(InputError, match=r"line\.json (must read .*)?" + said):
        camera_names(recorded)


def test_cameras_that_the_line_file_does_not_name_are_told(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """They were left out without a word: `replay` counted what one of two cameras saw, with all belt seen."""
    for name in ("rear", "side"):
        shutil.copytree(recorded / "front", recorded / name)
    (recorded / "line.json").write_text('{"cameras": ["front", "rear", "side"]}')
    assert inspect_recording(recorded).warnings == ()
    (recorded / "line.json").write_text('{"cameras": ["front"]}')
    (told,) = inspect_recording(recorded).warnings
    assert "line.json names front alone, so 'rear', 'side' beside it is left out; name it in" in told
    convert(recorded, tmp_path / "out.mcap")
    assert capsys.readouterr().err == f"warning: {told}\n"


@pytest.mark.parametrize(
    ("name", "changes", "said"),
    [
        ("left cam", {}, r"camera name 'left cam' cannot be used: 1 to 64 letters.*; rename the camera's folder"),
        ("front", {"resting_offset_mm": 45}, r"camera\.json cannot be used:\n  resting_offset_mm: .* \(got 45\)"),
        ("front", {"resting_sd_mm": 25}, r"camera\.json cannot be used:\n  resting_sd_mm: .* \(got 25\)"),
    ],
)
def test_what_no_line_can_take_is_refused_and_nothing_is_made(
    recorded: Path, tmp_path: Path, name: str, changes: dict[str, Any], said: str
) -> None:
    """It was refused as a fault of a config that no one had written, and left an empty folder of results."""
    edit(recorded, **changes)
    (recorded / "front").rename(recorded / name)
    with pytest.raises(InputError, match=said) as caught:
        replay_recording(recorded, out=tmp_path / "out")
    assert str(recorded) in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_commands_without_a_line_refuse_a_name_as_replay_does(recorded: Path) -> None:
    """`segment` said 0 counted of a camera called so: its tracks' ids were out of range, and all were discarded."""
    (recorded / "front").rename(recorded / "left cam")
    with pytest.raises(InputError, match=r"camera name 'left cam' cannot be used: .*; rename the camera's folder"):
        open_cameras(recorded)


def test_a_setting_that_is_refused_leaves_nothing(recorded: Path, tmp_path: Path) -> None:
    """The folder of results stayed, empty."""
    with pytest.raises(tuberline.TuberlineError, match="views_per_tuber"):
        replay_recording(recorded, out=tmp_path / "out", settings={"segmenter": {"views_per_tuber": 0}})
    assert not (tmp_path / "out").exists()


def test_a_recording_without_a_readable_frame_is_refused_with_the_first_fault(recorded: Path, tmp_path: Path) -> None:
    """The whole line was started for it, and said at the end that no frame had arrived."""
    for file in (recorded / "front" / "depth").iterdir():
        cv2.imwrite(str(file), np.full((48, 64), 115, np.uint8))
    with pytest.raises(InputError, match=r"no frame can be read; the first: frame 0: .*000000\.png is no 16-bit"):
        replay_recording(recorded, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_one_camera_without_a_readable_frame_keeps_no_other_from_being_counted(recorded: Path) -> None:
    shutil.copytree(recorded / "front", recorded / "rear")
    for file in (recorded / "rear" / "depth").iterdir():
        file.unlink()
    assert check_readable(recorded) == ["front", "rear"]
    (recorded / "front" / "mask").mkdir(exist_ok=True)
    for file in (recorded / "front" / "depth").iterdir():
        cv2.imwrite(str(recorded / "front" / "mask" / file.name), np.zeros((48, 64, 3), np.uint8))
    with pytest.raises(InputError, match=r"mask/000000\.png is no PNG of one channel.*or ignore the masks"):
        check_readable(recorded)
    assert check_readable(recorded, ignore_masks=True) == ["front", "rear"]
    for file in (recorded / "front" / "depth").iterdir():
        file.unlink()
    with pytest.raises(InputError, match=r"no frame can be read; the first: frame 0: .*front/depth/000000\.png"):
        check_readable(recorded)


@pytest.mark.parametrize("pose", [np.diag([1.0, 1, 1, 1]), np.array([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0.4]])])
def test_a_camera_that_does_not_look_down_is_refused_with_its_file(recorded: Path, pose: np.ndarray) -> None:
    """The text did not say which file of which camera."""
    full = np.vstack([pose[:3], [0, 0, 0, 1]])
    edit(recorded, belt_from_camera=full.tolist())
    with pytest.raises(InputError, match=r"front/camera\.json: .* away from the belt: .*tuberline calibrate"):
        describe_recording(recorded)


def test_cameras_that_are_said_to_hang_at_one_place_are_told(recorded: Path) -> None:
    """Two poses of null: 15 of 12 tubers were counted, at each camera's own place, without a word."""
    shutil.copytree(recorded / "front", recorded / "rear")
    sections = {name: CameraConfig() for name in ("front", "rear")}

    def told() -> list[str]:
        return hung_together(describe_recording(recorded).cameras, sections)

    assert told()[0].startswith("cameras front, rear are taken to hang at one place of the belt: give across_m")
    pose = straight_down_belt_from_camera(0.46)
    pose[1, 3] = 0.3
    edit(recorded, belt_from_camera=pose.tolist())
    assert told() == []
    sections["rear"] = CameraConfig(across_m=0.3)
    assert len(told()) == 1


def test_a_pose_in_millimetres_is_told_so(recorded: Path, tmp_path: Path) -> None:
    """It said that depth_scale_m should be 1, which is refused as well."""
    edit(recorded, belt_from_camera=straight_down_belt_from_camera(460.0).tolist())
    said = r"belt is said to be 460 m away: that seems to be in millimetres; .* are in metres"
    with pytest.raises(InputError, match=said):
        replay_recording(recorded, out=tmp_path / "out")


@pytest.mark.parametrize(("distance_m", "warnings"), [(0.46, 0), (0.56, 1)])
def test_a_belt_distance_that_is_told_twice_is_warned_of(recorded: Path, distance_m: float, warnings: int) -> None:
    edit(recorded, belt_from_camera=straight_down_belt_from_camera(0.46).tolist(), belt_distance_m=distance_m)
    told = inspect_recording(recorded).cameras[0].warnings
    assert len(told) == warnings
    assert all("belt_distance_m says 0.560 m along the optical axis, belt_from_camera 0.460 m" in text for text in told)


@pytest.mark.parametrize(("per_ns", "warnings"), [(1, 0), (1_000_000, 1)])
def test_capture_times_in_another_unit_are_warned_of(recorded: Path, per_ns: int, warnings: int) -> None:
    rows = [f"{seq},{seq * 33_000_000 // per_ns}," for seq in range(FRAMES)]
    (recorded / "front" / "frames.csv").write_text("\n".join(["seq,captured_ns,travel_m", *rows]) + "\n")
    told = inspect_recording(recorded).cameras[0].warnings
    assert len(told) == warnings
    assert all("3.3e-08 s apart but 30 frames a second are given: captured_ns must be in nano" in text for text in told)


def test_capture_times_in_another_unit_need_travel(recorded: Path) -> None:
    """The load could not have moved in so short a time: `replay` said 0 of 8 tubers, and 100 % of the belt seen."""
    for travel in (".1", ""):
        rows = [f"{seq},{seq * 33_000},{travel}" for seq in range(FRAMES)]
        (recorded / "front" / "frames.csv").write_text("\n".join(["seq,captured_ns,travel_m", *rows]) + "\n")
        if travel:
            assert check_readable(recorded) == ["front"]
    with pytest.raises(InputError, match=r"front: frames are captured 33000 ns apart, and their travel is not given"):
        check_readable(recorded)


def test_no_frame_is_decoded_twice_to_see_whether_a_recording_can_be_read(
    recorded: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without travel the first one was, to see the clock."""
    read: list[int] = []
    decode = FolderSource._frame

    def counted(source: FolderSource, row: Any, run: str) -> Any:
        read.append(row.seq)
        return decode(source, row, run)

    monkeypatch.setattr(FolderSource, "_frame", counted)
    assert check_readable(recorded) == ["front"]
    assert read == [0, 1]


def test_cameras_without_travel_need_a_clock_in_common(recorded: Path) -> None:
    """One that counted from 1970 and one from its start: tubers that both saw counted twice, 15 of 12."""
    shutil.copytree(recorded / "front", recorded / "rear")
    for travel in ("0.1", ""):
        rows = [f"{seq},{1_760_000_000 * 10**9 + seq * 33_000_000},{travel}" for seq in range(FRAMES)]
        (recorded / "rear" / "frames.csv").write_text("\n".join(["seq,captured_ns,travel_m", *rows]) + "\n")
        if travel:
            assert check_readable(recorded) == ["front", "rear"]
    with pytest.raises(InputError, match=r"cameras 'front' and 'rear' begin 488889 h apart, and their travel is not"):
        check_readable(recorded)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, None),
        ({"cx": 26.0, "cy": 28.0}, None),
        ({"cx": 48.0, "cy": 36.0}, r"principal point \(cx 48, cy 36\) lies far from the middle of 64x48 pixels"),
        ({"cy": 300.0}, r"principal point \(cx 31\.5, cy 300\) lies far"),
        ({"fy": 6.0}, r"fx 60 and fy 6 differ"),
    ],
)
def test_intrinsics_of_another_image_are_warned_of(recorded: Path, changes: dict[str, float], said: str | None) -> None:
    """Those of 1280x720 with frames of 848x480 were taken without a word; nothing was counted, or at wrong sizes."""
    edit(recorded, **changes)
    warnings = inspect_recording(recorded).cameras[0].warnings
    assert len(warnings) == (said is not None)
    assert all(re.search(str(said), text) for text in warnings)
