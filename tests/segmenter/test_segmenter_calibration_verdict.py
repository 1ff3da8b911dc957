"""`calibrate belt` says whether what it measured is good, by limits that are shown, and gives no pose of nonsense."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from conveyor.errors import InputError
from conveyor.formats.folder.writer import FolderWriter
from conveyor.formats.source import CameraDescription
from conveyor.geometry import Intrinsics
from conveyor.messages import Frame
from segmenter.calibrate import BeltCalibration
from segmenter.calibration_verdict import LIMITS, verdict
from tuberline.cli.calibrate_belt import calibrate_belt

K = Intrinsics(212, 120, 200.0, 200.0, 106.0, 60.0)
GOOD = BeltCalibration("front", 30, 30, 0.46, 0.2, 0.5, 1.0, 0.8, np.eye(4).tolist(), 0.46, 0.5, {})


def tilted(folder: Path, tilt_deg: float, *, scale_m: float = 0.001, k: Intrinsics = K, dark: int = 0) -> Path:
    """Frames of a plane, 460 units away along the axis, turned about the image's horizontal; without depth in the
    first `dark` columns.
    """
    v = np.arange(k.height)[:, None] * np.ones(k.width)
    z = 460 / (1 + np.tan(np.radians(tilt_deg)) * (v - k.cy) / k.fy)
    z[:, :dark] = 0
    description = CameraDescription("front", "test", k, scale_m, None, None, 30.0, 6)
    with FolderWriter(folder, description) as writer:
        for seq in range(6):
            depth = np.round(z).astype(np.uint16)
            writer.write(Frame("front", "r", seq, seq * 33_000_000, None, scale_m, k, None, depth))
    return folder


def test_each_measure_has_a_limit_that_it_can_pass() -> None:
    assert verdict(GOOD).word == "good"
    worse = {
        "spread": {"spread_mm": 1.5},
        "tilt": {"tilt_deg": 5.0},
        "residual": {"residual_mm": 9.0},
        "image without belt": {"belt_share": 0.2},
        "image without depth": {"without_depth": 0.3},
        "frames without belt": {"frames": 20},
        "off what is given": {"disagreement_mm": -15.0},
    }
    nonsense = {
        "spread": {"spread_mm": 329.0},
        "tilt": {"tilt_deg": 59.0},
        "residual": {"residual_mm": 40.0},
        "image without belt": {"belt_share": 0.03},
        "image without depth": {"without_depth": 0.97},
        "frames without belt": {"frames": 5},
        "off what is given": {"disagreement_mm": 120.0},
    }
    assert set(worse) == set(nonsense) == {limit.name for limit in LIMITS}
    for name, change in worse.items():
        found = verdict(replace(GOOD, **change))  # type: ignore[arg-type]
        assert found.word == "usable"
        assert len(found.findings) == 1
        assert found.findings[0].startswith(name)
    for name, change in nonsense.items():
        found = verdict(replace(GOOD, **change))  # type: ignore[arg-type]
        assert found.word == "refused"
        assert name in found.findings[0]
    assert verdict(replace(GOOD, belt_distance_m=11.57)).word == "refused"


def test_a_lens_that_is_mostly_covered_is_not_good(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Three quarters of the picture were dark, and the camera was called good."""
    calibrate_belt(tilted(tmp_path / "r", 0.5, k=Intrinsics(848, 480, 800.0, 800.0, 424.0, 240.0), dark=640), json=True)
    (camera,) = json.loads(capsys.readouterr().out)
    assert camera["verdict"] == "usable"
    (found,) = camera["findings"]
    assert found == "image without depth 75.5 %, good is up to 20: clean the front glass, and look at the light"


def test_a_good_belt_is_told_with_its_distance(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = tilted(tmp_path / "r", 0.5)
    calibrate_belt(recording, json=True)
    (camera,) = json.loads(capsys.readouterr().out)
    assert (camera["verdict"], camera["findings"]) == ("good", [])
    calibrate_belt(recording)
    said = capsys.readouterr()
    assert said.out.startswith("camera 'front' is good: belt_distance_m = 0.4")
    assert max(map(len, said.err.splitlines())) <= 80
    assert "to 0.5" in said.err
    assert "over 25" in said.err


@pytest.mark.parametrize("as_json", [False, True])
@pytest.mark.parametrize(("tilt_deg", "scale_m"), [(40.0, 0.001), (1.0, 0.01)])
def test_nonsense_is_refused_and_gives_no_pose(
    tilt_deg: float, scale_m: float, as_json: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A tilt of 59 degrees and a spread of 329 mm were printed as a calibration, without a word."""
    recording = tilted(tmp_path / "r", tilt_deg, scale_m=scale_m)
    with pytest.raises(InputError, match="no calibration of camera front"):
        calibrate_belt(recording, json=as_json)
    assert capsys.readouterr().out == ""
