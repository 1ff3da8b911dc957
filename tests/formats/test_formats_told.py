"""What is suspicious about a recording before a frame is looked at is told by every command that reads one."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from conveyor.formats.inspection import inspect_recording, told_at_once
from tests.formats.consumers import frames, write_folder
from tests.segmenter.segmenter_scene import SMALL
from tuberline.cli.calibrate_belt import calibrate_belt
from tuberline.cli.calibrate_cameras import calibrate_cameras
from tuberline.cli.camera_profile import profile
from tuberline.cli.import_frames import import_frames
from tuberline.cli.recordings import convert
from tuberline.cli.segmentation import evaluate_segmentation, segment

SQUEEZED = replace(SMALL, fy=SMALL.fy * 0.9)
DIFFER = f"fx {SQUEEZED.fx:g} and fy {SQUEEZED.fy:g} differ, but depth cameras have square pixels"
COMMANDS: dict[str, Callable[[Path], None]] = {
    "segment": segment,
    "evaluate-segmentation": evaluate_segmentation,
    "calibrate belt": calibrate_belt,
    "calibrate cameras": lambda recording: calibrate_cameras(recording, seconds=5),
    "camera profile": profile,
    "convert": lambda recording: convert(recording, recording.parent / "converted"),
}


@pytest.fixture(scope="module")
def squeezed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A camera whose rows say another focal length than its columns."""
    made = [replace(frame, intrinsics=SQUEEZED) for frame in frames()]
    return write_folder(tmp_path_factory.mktemp("squeezed") / "r", made=made, intrinsics=SQUEEZED)


@pytest.mark.parametrize("command", list(COMMANDS))
def test_focal_lengths_that_differ_are_told(command: str, squeezed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`info` and `replay` told it, from a quarter on; the others measured wrong sizes without a word."""
    COMMANDS[command](squeezed)
    told = [line for line in capsys.readouterr().err.splitlines() if DIFFER in line]
    assert len(told) == 1
    assert told[0].startswith("warning: camera 'front': ")


@pytest.mark.parametrize(
    ("depth_scale_m", "told"), [(0.0001, False), (0.001, False), (0.0015, False), (0.002, True), (0.005, True)]
)
def test_a_depth_unit_that_is_too_coarse_is_told(
    depth_scale_m: float, told: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of steps of 5 mm tubers were refused as clods without a word."""
    units = np.full((SMALL.height, SMALL.width), round(0.46 / depth_scale_m), np.uint16)
    made = [replace(frame, depth=units, depth_scale_m=depth_scale_m) for frame in frames()]
    path = write_folder(tmp_path / "r", made=made, intrinsics=SMALL)
    camera_json = path / "front" / "camera.json"
    described = json.loads(camera_json.read_text(encoding="utf-8"))
    camera_json.write_text(json.dumps(described | {"depth_scale_m": depth_scale_m}), encoding="utf-8")
    said = f"camera 'front': depth_scale_m says {depth_scale_m:g}: depth in steps of {1000 * depth_scale_m:g} mm"
    assert any(text.startswith(said) for text in told_at_once(path)) == told
    (camera,) = inspect_recording(path).cameras
    assert any("Record again in the camera's own unit" in text for text in camera.warnings) == told
    convert(path, tmp_path / "converted.mcap")
    assert (f"warning: {said}" in capsys.readouterr().err) == told


def test_all_say_what_info_says(squeezed: Path) -> None:
    """`replay` tells the same list; of a belt along the columns it named the focal lengths the wrong way round."""
    (camera,) = inspect_recording(squeezed).cameras
    assert [f"camera 'front': {text}" for text in camera.warnings] == told_at_once(squeezed)
    path = squeezed / "front" / "camera.json"
    described = path.read_text()
    along_columns = [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.46], [0, 0, 0, 1]]
    path.write_text(json.dumps(json.loads(described) | {"belt_from_camera": along_columns}))
    try:
        assert any(DIFFER in text for text in told_at_once(squeezed))
    finally:
        path.write_text(described)


def test_an_import_tells_it_of_the_intrinsics_that_it_is_given(
    squeezed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    k = {"fx": SQUEEZED.fx, "fy": SQUEEZED.fy, "cx": SQUEEZED.cx, "cy": SQUEEZED.cy}
    (tmp_path / "K.json").write_text(json.dumps(k))
    import_frames(
        squeezed / "front" / "depth", intrinsics=tmp_path / "K.json", depth_unit=0.001, fps=30.0, out=tmp_path / "out"
    )
    assert f"warning: {DIFFER}" in capsys.readouterr().err


@pytest.mark.parametrize("off_m", [0.0, 0.03])
def test_a_belt_that_a_tilted_camera_sees_is_where_it_is_given(off_m: float, tmp_path: Path) -> None:
    """Rightly given at 20 degrees it was told to seem 48 mm farther away."""
    sine, cosine, away_m = np.sin(np.radians(20)), np.cos(np.radians(20)), 0.46
    pose = np.array([[0, cosine, sine, 0], [1, 0, 0, 0], [0, sine, -cosine, away_m * cosine], [0, 0, 0, 1]])
    rows = (np.arange(SMALL.height)[:, None] - SMALL.cy) / SMALL.fy
    depth_m = np.broadcast_to((away_m + off_m) * cosine / (cosine - sine * rows), (SMALL.height, SMALL.width))
    made = [replace(frame, depth=np.rint(1000 * depth_m).astype(np.uint16)) for frame in frames()]
    path = write_folder(tmp_path / "r", made=made, intrinsics=SMALL)
    described = json.loads((path / "front" / "camera.json").read_text())
    (path / "front" / "camera.json").write_text(json.dumps(described | {"belt_from_camera": pose.tolist()}))
    (camera,) = inspect_recording(path).cameras
    assert camera.belt_seen_m == pytest.approx(away_m + off_m, abs=0.003)
    assert any("the belt seems" in text for text in camera.warnings) == bool(off_m)
