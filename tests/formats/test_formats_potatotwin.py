"""3DPotatoTwin folders, with the real picture of R9-9 where the shared data are."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from conveyor.errors import InputError
from conveyor.formats import Refused, describe_recording, open_source
from conveyor.messages import Frame

INTRINSICS = {
    "width": 64,
    "height": 48,
    "intrinsic_matrix": [60.0, 0, 0, 0, 61.0, 0, 31.5, 23.5, 1],
    "depth_scale": 1000.0,
}


def _twin(root: Path, labels: dict[str, tuple[str, list[int]]]) -> Path:
    """A data set whose tubers are 12x10 px boxes at their rows, 300 mm away."""
    (root / "1_rgbd" / "0_camera_intrinsics").mkdir(parents=True)
    (root / "1_rgbd" / "0_camera_intrinsics" / "a_settings.json").write_text(json.dumps({"laser": 0}))
    (root / "1_rgbd" / "0_camera_intrinsics" / "d405.json").write_text(json.dumps(INTRINSICS))
    rows = ["label,growing_season"]
    for label, (season, positions) in labels.items():
        folder = root / "1_rgbd" / "1_image" / label
        folder.mkdir(parents=True)
        rows.append(f"{label},{season}")
        for row in positions:
            depth, rgba = np.full((48, 64), 345, np.uint16), np.zeros((48, 64, 4), np.uint8)
            depth[row - 5 : row + 5, 20:32] = 300
            rgba[row - 5 : row + 5, 20:32] = 255
            cv2.imwrite(str(folder / f"{label}_depth_{row:03d}.png"), depth)
            cv2.imwrite(str(folder / f"{label}_rgb_{row:03d}.png"), rgba)
    (root / "ground_truth.csv").write_text("\n".join(rows))
    return root


def test_seasons_are_cameras_with_their_belt_distance(tmp_path: Path) -> None:
    root = _twin(tmp_path, {"R1-1": ("2023", [10, 20]), "2025-000": ("2025", [30])})
    cameras = describe_recording(root).cameras
    assert [(c.name, c.belt_distance_m, c.frames) for c in cameras] == [("2023", 0.345, 2), ("2025", 0.465, 1)]
    k = cameras[0].intrinsics
    assert (k.fx, k.fy, k.cx, k.cy) == (60.0, 61.0, 31.5, 23.5)  # column-major
    assert cameras[0].depth_scale_m == 0.001


def test_a_table_of_a_spreadsheet_and_a_label_without_images_are_no_cameras_of_their_own(tmp_path: Path) -> None:
    """'2023.0' had no belt distance, and one empty folder refused all: no depth 'of season unknown'."""
    root = _twin(tmp_path, {"R1-1": ("2023.0", [10, 20]), "S3-9": ("", [])})
    assert [(c.name, c.belt_distance_m, c.frames) for c in describe_recording(root).cameras] == [("2023", 0.345, 2)]
    shutil.rmtree(root / "1_rgbd/1_image/R1-1")
    with pytest.raises(InputError, match=r"1_image holds no <label>/<label>_depth_<row>\.png of any tuber"):
        describe_recording(root)


def test_labels_follow_each_other_with_masks_and_travel(tmp_path: Path) -> None:
    root = _twin(tmp_path, {"R1-2": ("2023", [35, 15]), "R1-1": ("2023", [10, 20, 30])})
    frames = list(open_source(root).frames(run="x"))
    assert all(isinstance(frame, Frame) for frame in frames)
    assert [frame.seq for frame in frames] == [0, 1, 2, 3, 4]
    rows = [np.nonzero(frame.mask)[0].mean() for frame in frames]
    np.testing.assert_allclose(rows, [9.5, 19.5, 29.5, 14.5, 34.5])
    per_row_m = (0.345 - 0.025) / 61.0
    np.testing.assert_allclose(
        np.diff([frame.travel_m for frame in frames]), [10 * per_row_m, 10 * per_row_m, 0.6, 20 * per_row_m]
    )
    assert set(np.unique(frames[0].mask)) == {0, 1}


def test_a_picture_without_its_mask_is_refused_by_name(tmp_path: Path) -> None:
    root = _twin(tmp_path, {"R1-1": ("2023", [10, 20])})
    (root / "1_rgbd" / "1_image" / "R1-1" / "R1-1_rgb_010.png").unlink()
    items = list(open_source(root).frames(run="x"))
    assert isinstance(items[0], Refused)
    assert items[0].reason == "no_mask"
    assert "R1-1_rgb_010.png" in items[0].text
    assert isinstance(items[1], Frame)


def test_without_intrinsics_it_says_where_they_belong(tmp_path: Path) -> None:
    root = _twin(tmp_path, {"R1-1": ("2023", [10])})
    (root / "1_rgbd" / "0_camera_intrinsics" / "d405.json").unlink()
    with pytest.raises(InputError, match=r"0_camera_intrinsics holds no JSON file with an intrinsic_matrix"):
        open_source(root)


def test_the_real_tuber_r9_9_is_read_as_it_was_recorded(shared: Path, tmp_path: Path) -> None:
    """The derived pictures are loss-free projections of the published cloud: 10,972 points."""
    sample = shared / "data" / "potatotwin_sample"
    folder = tmp_path / "1_rgbd" / "1_image" / "R9-9"
    folder.mkdir(parents=True)
    (tmp_path / "1_rgbd" / "0_camera_intrinsics").mkdir()
    shutil.copy(sample / "realsense_d405_intrinsic.json", tmp_path / "1_rgbd" / "0_camera_intrinsics")
    shutil.copy(sample / "derived" / "R9-9_pcd_365_depth_z16_mm.png", folder / "R9-9_depth_365.png")
    shutil.copy(sample / "derived" / "R9-9_pcd_365_rgba.png", folder / "R9-9_rgb_365.png")
    (tmp_path / "ground_truth.csv").write_text("label,growing_season\nR9-9,2023\n")
    frame = next(iter(open_source(tmp_path).frames(run="x")))
    assert isinstance(frame, Frame)
    assert np.count_nonzero(frame.depth[frame.mask > 0]) == 10_972
    assert (frame.intrinsics.fx, frame.belt_distance_m) == (pytest.approx(653.7628), 0.345)
    assert frame.depth_scale_m == pytest.approx(0.001, rel=1e-6)
