"""The commands on a folder recording written here: tracks, pictures, scores and calibration, and clear errors."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from segmenter_scene import SMALL, Scene, scattered

from conveyor.errors import InputError
from tuberline.cli.calibrate_belt import calibrate_belt
from tuberline.cli.calibrate_cameras import calibrate_cameras
from tuberline.cli.segmentation import evaluate_segmentation, segment

STEP_M = 0.0133
BODIES = scattered(6, seed=8)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Forty frames of six tubers, with masks."""
    root = tmp_path_factory.mktemp("recording")
    folder = root / "front"
    for name in ("depth", "mask"):
        (folder / name).mkdir(parents=True)
    scene = Scene(BODIES, noise_m=0.001)
    rows = ["seq,captured_ns,travel_m"]
    for seq in range(40):
        depth, labels = scene.render(seq * STEP_M, seq)
        cv2.imwrite(str(folder / "depth" / f"{seq:06d}.png"), depth)
        cv2.imwrite(str(folder / "mask" / f"{seq:06d}.png"), labels)
        rows.append(f"{seq},{seq * 33_333_333},{seq * STEP_M}")
    (folder / "frames.csv").write_text("\n".join(rows) + "\n")
    k = SMALL
    camera = {"name": "front", "width": k.width, "height": k.height, "fx": k.fx, "fy": k.fy, "cx": k.cx, "cy": k.cy}
    camera |= {"depth_scale_m": 0.001, "belt_distance_m": 0.46, "belt_from_camera": None, "fps": 30}
    (folder / "camera.json").write_text(json.dumps(camera))
    return root


def test_segment_counts_and_draws(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "deep" / "frame.png"
    segment(recording, picture=picture, json=True)
    (camera,) = json.loads(capsys.readouterr().out)
    crossed = [b for b in BODIES if -39 * STEP_M < b.place_x_m < 0]
    assert len(camera["tracks"]) == len(crossed) == 6
    assert camera["looked_at_m"] == pytest.approx(39 * STEP_M)
    image = cv2.imread(str(picture))
    assert image.shape == (SMALL.height, SMALL.width, 3)
    assert image.std() > 20


def test_masks_of_one_label_for_all_are_told(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Masks of 0 and 255: `replay` counted 0 of 8 tubers, with all belt seen and no word."""
    binary = shutil.copytree(recording, tmp_path / "binary")
    for path in (binary / "front" / "mask").glob("*.png"):
        labels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(path), np.where(labels > 0, 255, 0).astype(np.uint16))
    for folder, counted, told in ((recording, 6, False), (binary, 0, True)):
        segment(folder, masks=True, json=True)
        (camera,) = json.loads(capsys.readouterr().out)
        assert len(camera["tracks"]) == counted
        findings = [text for text in camera["findings"] if "a label of the given masks lies in several places" in text]
        assert len(findings) == len(camera["findings"]) == told
        evaluate_segmentation(folder, every=4, json=True)
        said = capsys.readouterr()
        assert ("a label of the masks lies in several places" in said.err) == told
        assert (json.loads(said.out)["masks_merged"] > 0) == told


def test_evaluate_segmentation_scores_the_masks(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    evaluate_segmentation(recording, every=4, json=True)
    score = json.loads(capsys.readouterr().out)
    assert score["f1_50"] > 0.98
    assert score["panoptic_quality"] > 0.9
    assert score["frames"] == 10
    assert 0 < score["split_ms"] < score["whole_step_ms"] * 2


def test_calibrate_belt_measures_distance_and_tilt(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    calibrate_belt(recording, json=True)
    (camera,) = json.loads(capsys.readouterr().out)
    assert camera["belt_distance_m"] == pytest.approx(0.46, abs=0.0005)
    assert camera["tilt_deg"] < 0.2
    assert camera["disagreement_mm"] == pytest.approx(0, abs=0.5)
    assert np.array(camera["belt_from_camera"]).shape == (4, 4)


def test_errors_name_the_file_and_what_it_lacks(recording: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no recording Tuberline knows; looked for: a folder recording"):
        segment(tmp_path)
    broken = tmp_path / "broken"
    (broken / "depth").mkdir(parents=True)
    (broken / "frames.csv").write_text("seq,captured_ns,travel_m\n0,0,\n")
    (broken / "camera.json").write_text('{"name": "front", "width": 424, "height": 240, "depth_scale_m": 0.001}')
    with pytest.raises(InputError, match=r"(?s)camera\.json cannot be used.*fx: missing.*cy: missing"):
        segment(broken)
    (broken / "camera.json").write_text((recording / "front" / "camera.json").read_text())
    (broken / "depth" / "000000.png").write_bytes(b"\x89PNG\r\n\x1a\n torn")
    with pytest.raises(InputError, match=r"no frame can be read; the first: .*000000\.png is truncated"):
        segment(broken)
    microseconds = [f"{seq},{seq * 33_333}," for seq in range(40)]
    (broken / "frames.csv").write_text("\n".join(["seq,captured_ns,travel_m", *microseconds]) + "\n")
    shutil.copytree(recording / "front" / "depth", broken / "depth", dirs_exist_ok=True)
    for command in (segment, calibrate_cameras):  # 0 of 6 tubers, without a word
        with pytest.raises(InputError, match=r"frames are captured 33333 ns apart, and their travel is not given"):
            command(broken)
    (broken / "frames.csv").write_text("number\n1\n")
    with pytest.raises(InputError, match=r"frames\.csv line 1: the header must be 'seq,captured_ns,travel_m'"):
        segment(broken)
