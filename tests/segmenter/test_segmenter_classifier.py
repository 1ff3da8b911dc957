"""The classifier: what the network is asked, what its answer does, and that it can be switched off."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from pathlib import Path
from statistics import fmean

import cv2
import numpy as np
import pytest
from segmenter_scene import MEDIUM, Scene, scattered

from conveyor.config import parse_config
from conveyor.errors import ConfigError, InputError
from conveyor.geometry import Intrinsics, straight_down_belt_from_camera
from segmenter.classify.classifier import Classifier
from segmenter.classify.evidence import SURE, Answer, Evidence, PatchNoise, noise_of
from segmenter.classify.patch import LEAST_OBSERVATIONS, Observation, Patch, observe_instance
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.heights import HeightMap, height_map
from segmenter.frame.instances import SplitSettings, given, split
from segmenter.perception import Perception, PerceptionSettings
from segmenter.pipeline import Segmenter, Settings
from segmenter.setup import core_settings
from segmenter.studies.distractors import LoadScore, LoadTruth
from segmenter.track.counting import CountSettings, class_refusal

ROOT = Path(__file__).resolve().parents[2]
QUIET = PatchNoise(spread_mm=1.5, error_mm=0.3, hole_share=0.05, observations=28)
BELT_POSE = straight_down_belt_from_camera(0.46)


def patch_of(height_mm: np.ndarray, *, noise_mm: float, observations: int, seed: int = 8) -> Patch:
    """The patch of one body on a raster of 1 mm cells, from several observations with noise."""
    rng = np.random.default_rng(seed)
    belt = BeltGeometry(Intrinsics(200, 160, 435.0, 435.0, 100.0, 80.0), BELT_POSE)
    patch = Patch()
    for _ in range(observations):
        noisy = np.maximum(height_mm + rng.normal(0, noise_mm, height_mm.shape), 0).astype(np.float32)
        heights = HeightMap(noisy, np.ones(height_mm.shape, np.uint8), 1, 1.0)
        instances = given((height_mm > 8).astype(np.uint16), heights, belt)
        x_m, y_m = instances.centre_m[0].tolist()
        patch.add(observe_instance(heights, instances, 0, belt, x_m=x_m, y_m=y_m))
    return patch


def body(*, rough_mm: float) -> np.ndarray:
    """(160, 200) half a body of 76 x 52 x 50 mm, as full as tubers are; `rough_mm`: rms of knobs 8 mm wide on it."""
    i, j = np.mgrid[:160, :200]
    rise = 1 - np.abs((i - 80) / 26.0) ** 2.4 - np.abs((j - 100) / 38.0) ** 2.4
    knobs = cv2.GaussianBlur(np.random.default_rng(5).normal(0, 1, rise.shape), (0, 0), 2.5)
    smooth = 25 * np.maximum(rise, 0) ** (1 / 2.4) + 25 * (rise > 0)
    return np.where(rise > 0, smooth + rough_mm * knobs / knobs.std(), 0).astype(np.float32)


def test_a_patch_is_the_mean_of_its_observations_with_their_spread() -> None:
    rng = np.random.default_rng(1)
    whole = np.ones((48, 48), np.float32)
    observations = [Observation(rng.uniform(20, 40, (48, 48)).astype(np.float32), whole, whole) for _ in range(5)]
    patch = Patch()
    for observation in observations:
        patch.add(observation)
    heights = np.stack([observation.height_mm for observation in observations])
    channels = patch.channels()
    assert np.allclose(channels[0] * 60, heights.mean(axis=0), atol=1e-3)
    assert np.allclose(channels[3] * 3, np.minimum(heights.std(axis=0), 9), atol=1e-2)
    assert (channels[[2, 4]] == 1).all()


def test_a_patch_shows_the_same_millimetres_whatever_the_camera() -> None:
    """A body of 60 mm is 30 cells wide and in the middle, at every resolution and belt distance."""
    for width, height, focal, distance_m in (
        (848, 480, 433.0, 0.46),
        (1280, 720, 653.0, 0.46),
        (848, 480, 433.0, 0.35),
    ):
        pose = straight_down_belt_from_camera(distance_m)
        belt = BeltGeometry(Intrinsics(width, height, focal, focal, width / 2, height / 2), pose)
        depth = np.full((height, width), round(distance_m * 1e4), np.uint16)
        half, u, v = round(0.030 * focal / (distance_m - 0.025)), width // 2 + 90, height // 2 - 33
        depth[v - half : v + half, u - half : u + half] = round((distance_m - 0.025) * 1e4)
        heights = height_map(depth, depth_scale_m=1e-4, belt=belt, pixel_mm=1.45)
        instances = split(heights, belt, SplitSettings())
        x_m, y_m = instances.centre_m[0].tolist()
        observation = observe_instance(heights, instances, 0, belt, x_m=x_m, y_m=y_m)
        rows, columns = np.nonzero(observation.inside > 0.5)
        assert len(rows) == pytest.approx(900, rel=0.06)
        assert (rows.mean(), columns.mean()) == pytest.approx((23.5, 23.5), abs=1.0)
        assert observation.height_mm[20:28, 20:28] == pytest.approx(25.0, abs=0.5)


def answer(log_odds: float) -> Answer:
    return Answer(log_odds, Evidence((log_odds,), QUIET))


def test_only_sure_answers_reject() -> None:
    settings = CountSettings(reject_below=-1.5)
    assert class_refusal(None, settings) is None
    assert class_refusal(answer(-1.4), settings) is None
    assert class_refusal(answer(-1.6), settings) == "distractor"


@pytest.mark.parametrize("noise_mm", [0.5, 1.0, 2.0])
def test_the_noise_of_a_patch_is_that_of_its_frames(noise_mm: float) -> None:
    """Cells of 2 mm over a raster of 1 mm average four readings."""
    noise = noise_of(patch_of(body(rough_mm=0.0), noise_mm=noise_mm, observations=20))
    assert noise.spread_mm == pytest.approx(noise_mm / 2, rel=0.15)
    assert noise.error_mm == pytest.approx(noise.spread_mm / np.sqrt(20), rel=0.02)
    assert (noise.hole_share, noise.observations) == (pytest.approx(0.0, abs=0.01), 20)


@pytest.mark.parametrize("seed", range(5))
def test_the_sums_and_the_noise_of_a_patch_are_those_of_its_observations(seed: int) -> None:
    """To the bit, also of cells that hardly anything was seen of, and whatever the number of cells."""
    rng = np.random.default_rng([41, seed])
    patch, sums = Patch(), np.zeros((4, 48, 48), np.float32)
    for _ in range(int(rng.integers(3, 30))):
        seen = (rng.random((48, 48)) < rng.uniform(0.2, 0.9)).astype(np.float32)
        height = (seen * rng.uniform(0, 90, (48, 48))).astype(np.float32)
        inside = (seen * np.round(rng.random((48, 48)), 1)).astype(np.float32)
        inside[:20] = seen[:20]
        patch.add(Observation(height, seen, inside))
        for total, one in zip(sums, (height, height * height, seen, inside), strict=True):
            total += one
    for total, kept in zip(sums, (patch._height, patch._square, patch._seen, patch._inside), strict=True):
        assert np.array_equal(total, kept)
    count = np.maximum(sums[2], np.float32(1))
    mean_mm, sure = sums[0] / count, sums[3] / count > SURE
    spread_mm = np.sqrt(np.maximum(sums[1] / count - mean_mm * mean_mm, 0))[sure]
    assert len(spread_mm) > 100
    noise = noise_of(patch)
    assert noise.spread_mm == float(np.median(spread_mm))
    assert noise.error_mm == float(np.median(spread_mm / np.sqrt(count[sure])))
    assert noise.hole_share == float(1 - count[sure].mean() / patch.observations)


@pytest.mark.parametrize("noise_mm", [0.0, 1.0, 2.0])
def test_a_rough_body_is_told_from_a_smooth_one_through_noise(noise_mm: float) -> None:
    classifier = Classifier()
    assert fmean(classifier.answers(patch_of(body(rough_mm=0.0), noise_mm=noise_mm, observations=10))) > 1.0
    assert fmean(classifier.answers(patch_of(body(rough_mm=3.0), noise_mm=noise_mm, observations=10))) < -1.5


def test_the_one_real_tuber_at_hand_is_a_tuber(shared: Path) -> None:
    """A depth image of 3DPotatoTwin (R9-9, D405, belt at 0.345 m), looked at three times."""
    sample = shared / "data" / "potatotwin_sample"
    depth = cv2.imread(str(sample / "derived" / "R9-9_pcd_365_depth_z16_mm.png"), cv2.IMREAD_UNCHANGED)
    mask = cv2.imread(str(sample / "derived" / "R9-9_pcd_365_rgba.png"), cv2.IMREAD_UNCHANGED)[:, :, 3] > 0
    k = json.loads((sample / "realsense_d405_intrinsic.json").read_text())["intrinsic_matrix"]
    intrinsics = Intrinsics(depth.shape[1], depth.shape[0], k[0], k[4], k[6], k[7])
    belt = BeltGeometry(intrinsics, straight_down_belt_from_camera(0.345))
    heights = height_map(np.where(mask, depth, 345).astype(np.uint16), depth_scale_m=0.001, belt=belt, pixel_mm=1.45)
    instances = given(mask.astype(np.uint16), heights, belt)
    x_m, y_m = instances.centre_m[0].tolist()
    patch = Patch()
    for _ in range(LEAST_OBSERVATIONS):
        patch.add(observe_instance(heights, instances, 0, belt, x_m=x_m, y_m=y_m))
    assert fmean(Classifier().answers(patch)) > 0.5


def test_smooth_bodies_of_another_simulator_are_counted() -> None:
    """Ellipsoids without any stereo camera's habits: a classifier out of its depth must not lose tubers."""
    bodies = scattered(9, seed=4)
    scene = Scene(bodies, MEDIUM, noise_m=0.001)
    core, closed = Segmenter(Settings(perception=PerceptionSettings("classes"))), []
    for n in range(28):
        closed += core.step(scene.frame(n, 0.02 * n)).closed
    closed += core.finish()
    crossed = sum(body.place_x_m > -0.02 * 27 for body in bodies)
    assert len(closed) == crossed >= 6
    assert core.discarded["distractor"] == 0


def test_observations_are_due_by_belt_travel_and_not_where_nothing_can_be_seen() -> None:
    heights = HeightMap(np.zeros((40, 50), np.float32), np.ones((40, 50), np.uint8), 1, 1.0)
    far = HeightMap(heights.height_mm, heights.seen, 1, 2.5)
    perception = Perception(PerceptionSettings("classes", observe_every_m=0.04), SplitSettings())
    due = [perception.observation_due(heights, travel_m) for travel_m in (0.0, 0.0, 0.02, 0.039, 0.041, 0.05, 0.09)]
    assert due == [True, False, False, False, True, False, True]
    assert not perception.observation_due(far, 1.0)
    assert perception.coarse == 1
    assert perception.classify(Patch(), limit=0.3) is None
    for observations, asked in ((LEAST_OBSERVATIONS - 1, False), (LEAST_OBSERVATIONS, True)):
        patch = patch_of(body(rough_mm=3.0), noise_mm=1.0, observations=observations)
        assert (perception.classify(patch, limit=0.3) is not None) == asked
    assert not Perception(PerceptionSettings("classical"), SplitSettings()).observation_due(heights, 0.0)


def test_every_lot_is_booked_once() -> None:
    score = LoadScore()
    truth = LoadTruth(
        tubers=np.array([[0.0, 0.0], [0.1, 0.0], [0.2, 0.0], [0.3, 0.0]]),
        distractors=np.array([[0.0, 0.1], [0.1, 0.1], [0.2, 0.1]]),
        kinds=("clod", "clod", "stone"),
    )
    counted = np.array([[0.001, 0.0], [0.1, 0.002], [0.1, 0.004], [0.0, 0.101], [0.5, 0.5]])
    score.add(truth, counted, np.array([[0.2, 0.0], [0.1, 0.1]]))
    assert (score.tubers_counted, score.tubers_rejected) == (2, 1)
    assert (score.distractors_counted, score.distractors_rejected, score.false) == (1, 1, 2)
    assert score.distractors_counted_share == pytest.approx(1 / 3)


def test_the_config_chooses_and_a_missing_file_says_what_to_do(tmp_path: Path) -> None:
    config = parse_config({"segmenter": {"method": "classes", "weights": str(tmp_path / "no.onnx")}}, where="here")
    with pytest.raises(InputError, match="train-classifier"):
        Segmenter(core_settings(config))
    (tmp_path / "no.onnx").write_bytes(b"no network")
    with pytest.raises(InputError, match="no network that onnxruntime"):
        Segmenter(core_settings(config))
    off = core_settings(parse_config({"segmenter": {"method": "classical"}}, where="here"))
    assert Segmenter(off).belt is None
    assert core_settings(parse_config({}, where="here")).perception == Settings().perception


def test_the_method_that_is_gone_is_refused_with_what_to_use() -> None:
    with pytest.raises(ConfigError, match=r"segmenter\.method: .*'learned' was removed.*\"classes\""):
        parse_config({"segmenter": {"method": "learned"}}, where="here")


def test_what_runs_never_imports_torch() -> None:
    for path in (ROOT / "segmenter").rglob("*.py"):
        if path.is_relative_to(ROOT / "segmenter" / "training"):
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [n for n in names if n.split(".")[0] == "torch" or n.startswith("segmenter.training")], path
    code = (
        "import sys\nimport segmenter.node\nfrom segmenter.pipeline import Segmenter, Settings\n"
        "Segmenter(Settings())\nsys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
