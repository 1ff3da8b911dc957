"""Every consumer of recordings on one file of every format: same frames, same refusals."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from conveyor.errors import InputError
from conveyor.formats import CameraDescription, describe_recording
from conveyor.formats.cameras import told_unreadable
from conveyor.formats.conversion import convert_recording
from conveyor.formats.inspection import inspect_recording
from conveyor.formats.mcap import writer as mcap_writer
from conveyor.formats.ros2.writer import Ros2McapWriter
from conveyor.formats.turned import QuarterTurn
from conveyor.geometry import straight_down_belt_from_camera
from segmenter.calibrate import calibrate_recording
from segmenter.studies.offline import segment_recording
from tests.formats.consumers import (
    BELT_M,
    BODIES,
    CONSUMERS,
    FRAMES,
    add_byte_order_mark,
    consumed,
    description,
    frames,
    not_rigid,
    refusals,
    write_bag,
    write_folder,
    write_mcap,
)
from tuberline.replayer import belt_said, stated_belt

NOT_RIGID = "belt_from_camera is no rigid transform (rotation rows must be orthonormal and right-handed"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two tubers, masks, and a byte-order mark in every text file."""
    root = write_folder(tmp_path_factory.mktemp("recording"))
    (root / "line.json").write_text(json.dumps({"cameras": ["front"], "belt_speed_mps": 0.6}))
    return root


def _check(recording: Path) -> None:
    seen = consumed(recording)
    report = seen["info"].cameras[0]
    assert (report.name, report.frames, report.masks, report.warnings) == ("front", FRAMES, True, ())
    for frame, made in zip(seen["replay"], frames(), strict=True):
        assert np.array_equal(frame.depth, made.depth)
        assert np.array_equal(frame.mask, made.mask)
        assert (frame.seq, frame.captured_ns, frame.travel_m) == (made.seq, made.captured_ns, made.travel_m)
    (calibration,) = seen["calibrate belt"]
    assert calibration.belt_distance_m == pytest.approx(BELT_M, abs=0.001)
    assert calibration.given_distance_m == BELT_M
    (segmented,) = seen["segment"]
    assert len(segmented.tracks) == len(BODIES)
    assert segmented.unreadable == {}
    score = seen["evaluate-segmentation"]
    assert score.f1_50 > 0.95
    assert score.frames == FRAMES


def test_a_folder_with_byte_order_marks(folder: Path, tmp_path: Path) -> None:
    """`replay` read it, `segment`, `calibrate belt` and `evaluate-segmentation` refused it with a false message."""
    marked = write_folder(tmp_path / "marked")
    (marked / "line.json").write_text((folder / "line.json").read_text())
    for name in ("line.json", "front/camera.json", "front/frames.csv"):
        add_byte_order_mark(marked / name)
    _check(marked)


@pytest.mark.parametrize("form", ["mcap", "ros2"])
def test_an_mcap_recording_needs_no_conversion(folder: Path, tmp_path: Path, form: str) -> None:
    if form == "ros2":
        pytest.importorskip("rosbags")
    convert_recording(folder, tmp_path / "r.mcap", form="ros2" if form == "ros2" else "mcap")
    assert describe_recording(tmp_path / "r.mcap").kind == ("ros2-export" if form == "ros2" else "mcap")
    _check(tmp_path / "r.mcap")


def test_a_bag_gives_its_belt_and_its_tubers(folder: Path, tmp_path: Path) -> None:
    """Bags know neither belt distance, travel nor masks: the first two are found, without masks nothing is scored."""
    pytest.importorskip("rosbags")
    bag = write_bag(folder, tmp_path / "bag.mcap")
    assert describe_recording(bag).kind == "rosbag"
    assert CONSUMERS["info"](bag).cameras[0].frames == len(CONSUMERS["replay"](bag)) == FRAMES
    (calibration,) = CONSUMERS["calibrate belt"](bag)
    assert calibration.belt_distance_m == pytest.approx(BELT_M, abs=0.001)
    assert calibration.given_distance_m is None
    assert CONSUMERS["segment"](bag)[0].frames == FRAMES
    with pytest.raises(InputError, match=r"bag\.mcap has no masks to compare with"):
        CONSUMERS["evaluate-segmentation"](bag)


def _bad_pose(tmp_path: Path, form: str) -> Path:
    d: CameraDescription = description()
    object.__setattr__(d, "belt_from_camera", not_rigid())  # refused where it is made, so written behind its back
    if form == "mcap":
        return write_mcap(tmp_path / "bad.mcap", frames(belt_from_camera=not_rigid()))
    if form == "ros2":
        pytest.importorskip("rosbags")
        with Ros2McapWriter(tmp_path / "bad.mcap") as writer:
            writer.add_camera(d)
            for frame in frames():
                writer.write(frame)
        return tmp_path / "bad.mcap"
    root = write_folder(tmp_path / "bad")
    path = root / "front" / "camera.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"belt_from_camera": not_rigid().tolist()}))
    return root


@pytest.mark.parametrize("form", ["folder", "mcap", "ros2"])
def test_a_pose_that_is_not_rigid_is_refused_by_all_in_the_same_words(tmp_path: Path, form: str) -> None:
    """The second reader of folders took it, and fed it to the calibration; MCAP was not asked at all."""
    said = refusals(_bad_pose(tmp_path, form))
    assert len(set(said.values())) == 1
    assert NOT_RIGID in said["info"]


def test_one_frame_with_a_bad_pose_is_a_gap(tmp_path: Path) -> None:
    made = frames()
    made[7] = replace(made[7], belt_from_camera=not_rigid())
    path = write_mcap(tmp_path / "r.mcap", made)
    refused = [item for item in CONSUMERS["replay"](path) if not hasattr(item, "depth")]
    assert [(item.seq, item.reason) for item in refused] == [(7, "bad_pose")]
    assert NOT_RIGID in refused[0].text
    assert CONSUMERS["segment"](path)[0].unreadable == {"bad_pose": 1}


def test_a_wrong_depth_scale_is_refused_by_all_that_measure(tmp_path: Path) -> None:
    root = write_folder(tmp_path / "scaled", depth_scale_m=0.0001)
    said = refusals(root, but=("info",))
    assert all("depth_scale_m is 0.0001 and should be 0.001" in text for text in said.values()), said
    assert any("should be 0.001" in warning for warning in CONSUMERS["info"](root).cameras[0].warnings)


def test_a_camera_mounted_a_quarter_turn_round_is_turned_for_all(tmp_path: Path) -> None:
    """The belt runs along its columns; `calibrate belt` prints the pose of the image as it was recorded."""
    turn = QuarterTurn(1)
    turned = [turn.frame(frame) for frame in frames(belt_from_camera=straight_down_belt_from_camera(BELT_M))]
    path = write_mcap(tmp_path / "turned.mcap", turned)
    (upright,) = segment_recording(write_folder(tmp_path / "upright"))
    (result,) = segment_recording(path)
    assert [round(t.place_x_m, 3) for t in result.tracks] == [round(t.place_x_m, 3) for t in upright.tracks]
    (calibration,) = calibrate_recording(path)
    recorded = turned[0].belt_from_camera
    assert recorded is not None
    np.testing.assert_allclose(calibration.belt_from_camera, recorded, atol=0.01)


def test_what_is_known_of_the_resting_level_goes_through_every_format(tmp_path: Path) -> None:
    root = write_folder(tmp_path / "r", resting_offset_mm=7.0, resting_sd_mm=1.5)
    convert_recording(root, tmp_path / "r.mcap")
    convert_recording(tmp_path / "r.mcap", tmp_path / "back")
    for path in (root, tmp_path / "r.mcap", tmp_path / "back"):
        (camera,) = describe_recording(path).cameras
        assert (camera.resting_offset_mm, camera.resting_sd_mm) == (7.0, 1.5)
    assert (tmp_path / "back/front/camera.json").read_bytes() == (root / "front/camera.json").read_bytes()


def test_a_resting_level_in_metres_is_told_and_the_recording_read(tmp_path: Path) -> None:
    """Nothing said it, and undersides lay 5 thousandths of a millimetre below the belt."""
    root = write_folder(tmp_path / "r", resting_offset_mm=0.0055, resting_sd_mm=1.5)
    (warning,) = [text for text in inspect_recording(root).cameras[0].warnings if "resting" in text]
    assert warning.startswith("resting_offset_mm says 0.0055: less than 0.05 mm cannot be known; 0.0055 m are 5.5 mm")
    (camera,) = describe_recording(root).cameras
    assert stated_belt([camera]) == {"resting_offset_mm": 0.0, "resting_sd_mm": 1.5}
    assert stated_belt([replace(camera, resting_offset_mm=None)]) == stated_belt([camera]), "a doubt without an offset"
    level = belt_said({"gauge": "travel"}, [camera], offset_mm=None, sd_mm=None)
    assert level == {"gauge": "travel"} | stated_belt([camera]), "a gauge does not say what tubers lie on"
    assert belt_said({"surface": "rods"}, [camera], offset_mm=2.0, sd_mm=None)["resting_offset_mm"] == 2.0
    assert belt_said({"surface": "rods"}, [camera], offset_mm=None, sd_mm=None) == {"surface": "rods"}


def test_an_mcap_recording_of_a_newer_version_is_refused_by_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mcap_writer, "FORMAT_VERSION", 2)
    said = refusals(write_mcap(tmp_path / "newer.mcap", frames()[:3]))
    assert len(set(said.values())) == 1
    assert "newer.mcap is a MCAP recording of version 2" in said["info"]
    assert "reads up to version 1" in said["info"]


def test_a_folder_with_one_broken_frame_is_read_without_it(tmp_path: Path) -> None:
    root = write_folder(tmp_path / "r")
    path = root / "front" / "depth" / "000003.png"
    path.write_bytes(path.read_bytes()[:200])
    (calibration,) = calibrate_recording(root)
    assert (calibration.frames, calibration.unreadable) == (FRAMES - 1, {"broken_png": 1})
    said = told_unreadable(calibration.unreadable, calibration.first_fault)
    assert said.startswith("frames that cannot be used: 1 broken png; the first: frame 3: ")
    assert said.endswith("000003.png is truncated or no PNG; copy it again"), "`info` looks at eight frames"
    assert CONSUMERS["segment"](root)[0].first_fault == calibration.first_fault
    assert CONSUMERS["evaluate-segmentation"](root).unreadable == {"broken_png": 1}
