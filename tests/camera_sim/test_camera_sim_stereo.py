"""The stereo camera's errors, against what two real D405 clouds show."""

from __future__ import annotations

import numpy as np
import pytest

from camera_sim.sim.optics import BASELINE_M, D405_1280
from camera_sim.sim.stereo import EASY, FIELD, NoiseBank, StereoNoise, measure

SIZE = (240, 320)
FOCAL = D405_1280.intrinsics.fx


def _measure(depth_m: np.ndarray, noise: StereoNoise = EASY, unit_m: float = 0.001, seed: int = 1) -> np.ndarray:
    bank = NoiseBank(np.random.default_rng(7), height=SIZE[0], width=SIZE[1])
    rng = np.random.default_rng(seed)
    return measure(depth_m.astype(np.float32), focal_px=FOCAL, unit_m=unit_m, noise=noise, bank=bank, rng=rng)


def test_a_perfect_camera_only_rounds() -> None:
    perfect = StereoNoise(fine_px=0, mid_px=0, smooth_px=0, edge_px=0, steep=99, bare=0)
    measured = _measure(np.full(SIZE, 0.46), perfect)
    border = int(np.ceil(FOCAL * BASELINE_M / 0.46))
    assert (measured[:, :border] == 0).all()  # the right imager does not see the left border
    step_m = 0.46**2 / (FOCAL * BASELINE_M) / 32
    assert np.abs(measured[:, border:] * 0.001 - 0.46).max() <= step_m / 2 + 0.0005


@pytest.mark.parametrize(("distance_m", "smooth_mm"), [(0.345, 0.6), (0.465, 1.1)])
def test_error_is_smooth_and_grows_with_distance(distance_m: float, smooth_mm: float) -> None:
    """Real: fine noise beside rounding below 0.2 mm; median distance to the tuber .67 and .95 mm."""
    measured = _measure(np.full(SIZE, distance_m), unit_m=0.0001)
    seen = measured[:, 60:][measured[:, 60:] > 0] * 0.1 - distance_m * 1000
    assert seen.std() == pytest.approx(smooth_mm, rel=0.4)
    step = np.diff(measured[:, 60:].astype(float) * 0.1, axis=1)
    assert np.median(np.abs(step)) < 0.5
    assert (measured[:, 60:] == 0).mean() < 0.01


def test_depth_comes_in_steps_of_a_32nd_of_a_pixel() -> None:
    measured = _measure(np.tile(np.linspace(0.40, 0.46, SIZE[1]), (SIZE[0], 1)), unit_m=0.0001)
    values = np.unique(measured[measured > 0])
    disparities = FOCAL * BASELINE_M / (values * 0.0001) * 32
    assert np.abs(disparities - np.round(disparities)).max() < 0.13  # the unit is a fifth of a step
    assert len(values) < 140


def test_edges_wander_and_the_shadow_side_has_no_depth() -> None:
    depth = np.full(SIZE, 0.46)
    depth[80:160, 120:220] = 0.38
    measured = _measure(depth, FIELD)
    shadow = round(FOCAL * BASELINE_M * (1 / 0.38 - 1 / 0.46))
    assert shadow >= 5
    row = measured[100:140, 120 - shadow : 120]
    assert (row == 0).mean() > 0.6
    inside = measured[90:150, 135:205]
    assert (inside == 0).mean() < 0.05
    assert abs(float(np.median(inside[inside > 0])) - 380) < 3


def test_frames_repeat_by_seed_alone() -> None:
    depth = np.full(SIZE, 0.46)
    assert np.array_equal(_measure(depth, seed=4), _measure(depth, seed=4))
    assert not np.array_equal(_measure(depth, seed=4), _measure(depth, seed=5))
