"""One 3DPotatoTwin folder through everything that reads one: replay's commands, training, and `weigh` of a pair."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from conveyor.errors import InputError
from conveyor.formats import describe_recording
from conveyor.formats.potatotwin.intrinsics import find_intrinsics, read_intrinsics
from conveyor.formats.potatotwin.pairs import read_pair
from conveyor.formats.potatotwin.writer import TwinFolderWriter
from conveyor.geometry import deproject
from regressor.training.labelled import read_labelled
from tests.formats.consumers import BELT_M, CONSUMERS, add_byte_order_mark, consumed
from tests.segmenter.segmenter_scene import SMALL, Body, Scene

ROWS = (90, 120, 150)
SCENE = Scene([Body(0.0, 0.0)], noise_m=0.0003, seed=2)


def _rim(mask: np.ndarray) -> np.ndarray:
    """Pixels just outside a mask."""
    wide = mask.copy()
    for axis in (0, 1):
        for by in (-1, 1):
            wide |= np.roll(mask, by, axis)
    return wide & ~mask


def _rendered(v: int) -> tuple[np.ndarray, np.ndarray]:
    """(depth, labels) of the tuber at the image row `v`."""
    return SCENE.render((v - SMALL.cy) * (BELT_M - 0.027) / SMALL.fy, v)


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One tuber of season 2099 at three rows, its rim half transparent, the belt distance in its own column."""
    root = tmp_path_factory.mktemp("twin")
    with TwinFolderWriter(root, SMALL, name="d405", belt_distances=True) as writer:
        row = {"label": "2099-000", "growing_season": "2099", "cultivar": "Test", "weight_g_inctack": 150.0}
        writer.add_tuber(row | {"belt_distance_m": BELT_M}, split="train")
        for v in ROWS:
            depth, labels = _rendered(v)
            rgba = np.full((*depth.shape, 4), 90, np.uint8)
            rgba[..., 3] = np.where(labels > 0, 255, np.where(_rim(labels > 0), 128, 0))
            points = deproject(np.where(labels > 0, depth, 0), depth_scale_m=0.001, intrinsics=SMALL)
            writer.add_view("2099-000", v, depth=depth, rgba=rgba, points=points)
    for name in ("ground_truth.csv", "splits.csv", "1_rgbd/0_camera_intrinsics/d405_camera_intrinsic.json"):
        add_byte_order_mark(root / name)
    return root


def test_every_consumer_sees_the_same_tuber(twin: Path) -> None:
    """Training said season 2099, 0.46 m, alpha 255; replay said season unknown, no belt, alpha above 0."""
    seen = consumed(twin)
    (camera,) = seen["info"].cameras
    assert (camera.name, camera.frames, camera.belt_given_m) == ("2099", len(ROWS), BELT_M)
    (calibration,) = seen["calibrate belt"]
    assert calibration.belt_distance_m == pytest.approx(BELT_M, abs=0.001)
    assert seen["segment"][0].frames == len(ROWS)
    assert seen["evaluate-segmentation"].instances_given == len(ROWS)
    views = list(read_labelled(twin, split="train"))
    assert [(view.season, view.belt_distance_m, view.weight_g) for view in views] == [("2099", BELT_M, 150.0)] * 3
    assert [view.row_share for view in views] == [v / SMALL.height for v in ROWS]
    for v, frame, view in zip(ROWS, seen["replay"], views, strict=True):
        assert (frame.camera, frame.belt_distance_m) == ("2099", BELT_M)
        path = twin / "1_rgbd" / "1_image" / "2099-000" / f"2099-000_depth_{v:03d}.png"
        intrinsics, scale_m = read_intrinsics(find_intrinsics(path))
        pair = read_pair(path, intrinsics=intrinsics, depth_scale_m=scale_m, max_depth_m=0.5)
        inside = int(np.count_nonzero(_rendered(v)[1]))
        counted = [np.count_nonzero(image) for image in (frame.mask, view.depth, pair.depth)]
        assert counted == [inside] * 3
        assert inside > 1000
        assert frame.depth_scale_m == view.depth_scale_m == scale_m


def test_a_season_without_a_belt_distance_is_fitted_by_replay_and_refused_by_training(
    twin: Path, tmp_path: Path
) -> None:
    root = tmp_path / "unknown"
    root.mkdir()
    shutil.copytree(twin / "1_rgbd", root / "1_rgbd")
    (root / "ground_truth.csv").write_text("label,growing_season,weight_g_inctack\n2099-000,2099,150\n")
    (camera,) = describe_recording(root).cameras
    assert (camera.name, camera.belt_distance_m) == ("2099", None)
    (calibration,) = CONSUMERS["calibrate belt"](root)
    assert calibration.belt_distance_m == pytest.approx(BELT_M, abs=0.001)
    with pytest.raises(InputError, match=r"season '2099' has no known belt distance; .* column belt_distance_m"):
        next(read_labelled(root))


def test_two_distances_in_one_season_are_two_cameras(twin: Path, tmp_path: Path) -> None:
    root = tmp_path / "two"
    images = root / "1_rgbd" / "1_image"
    images.mkdir(parents=True)
    intrinsics = "1_rgbd/0_camera_intrinsics"
    shutil.copytree(twin / intrinsics, root / intrinsics)
    for label in ("a", "b"):
        (images / label).mkdir()
        for path in (twin / "1_rgbd" / "1_image" / "2099-000").iterdir():
            shutil.copy(path, images / label / path.name.replace("2099-000", label))
    (root / "ground_truth.csv").write_text("label,growing_season,belt_distance_m\na,2099,0.46\nb,2099,0.47\n")
    cameras = describe_recording(root).cameras
    assert [(camera.name, camera.belt_distance_m) for camera in cameras] == [("2099-0.46", 0.46), ("2099-0.47", 0.47)]


@pytest.mark.parametrize("text", ["none", "nan", "-0.3", "460"])
def test_a_belt_distance_that_is_none_is_refused_with_its_line(twin: Path, tmp_path: Path, text: str) -> None:
    shutil.copytree(twin / "1_rgbd", tmp_path / "1_rgbd")
    table = f"label,growing_season,weight_g_inctack,belt_distance_m\n2099-000,2099,150,{text}\n"
    (tmp_path / "ground_truth.csv").write_text(table)
    for read in (describe_recording, lambda path: list(read_labelled(path))):
        with pytest.raises(InputError, match=rf"ground_truth\.csv line 2: belt_distance_m is '{text}'; allowed"):
            read(tmp_path)
