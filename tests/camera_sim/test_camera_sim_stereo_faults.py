"""What real cameras do beyond noise: each fault measured on known surfaces, in the strength that was asked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from camera_sim.sim.conditions import LOCAL_PX, draw_conditions
from camera_sim.sim.optics import BASELINE_M, D405_1280
from camera_sim.sim.stereo import NoiseBank, StereoNoise, measure
from camera_sim.sim.stereo_faults import bowed_field, lost_outlines
from camera_sim.sim.view_truth import pose_of, rim_of

SIZE = (240, 320)
FOCAL = D405_1280.intrinsics.fx
PERFECT = StereoNoise(fine_px=0, mid_px=0, smooth_px=0, edge_px=0, steep=99, bare=0)
FINE_UNIT_M = 1e-5
"""So fine that depth is rounded by the disparity's steps alone."""


def _measured(depth_m: np.ndarray, noise: StereoNoise, **more: np.ndarray) -> np.ndarray:
    """(h, w) disparity as measured, NaN where there is none."""
    bank = NoiseBank(np.random.default_rng(7), height=SIZE[0], width=SIZE[1])
    rng = np.random.default_rng(3)
    units = measure(
        depth_m.astype(np.float32), focal_px=FOCAL, unit_m=FINE_UNIT_M, noise=noise, bank=bank, rng=rng, **more
    )
    with np.errstate(divide="ignore"):
        return np.where(units > 0, FOCAL * BASELINE_M / (units * FINE_UNIT_M), np.nan)


def _local_px(disparity: np.ndarray) -> float:
    """Median sd of the residual to a quadric in windows of 11 x 11, the measure of the facts about real cameras."""
    v, u = (n.ravel() for n in np.mgrid[-5:6, -5:6])
    terms = np.stack([np.ones(121), u, v, u * u, v * v, u * v], axis=1)
    residual = np.eye(121) - terms @ np.linalg.pinv(terms)
    windows = [disparity[y : y + 11, x : x + 11].ravel() for y in range(5, 225, 13) for x in range(70, 305, 13)]
    return float(np.median([(residual @ window).std() for window in windows if np.isfinite(window).all()]))


def test_local_noise_is_what_was_drawn() -> None:
    for seed in range(12):
        world = draw_conditions("harsh", np.random.default_rng([5, seed]))
        noise = replace(world.preset.noise, islands=0.0, bare=0.0, steep=99.0)
        measured = _local_px(_measured(np.full(SIZE, 0.5), noise))
        assert world.local_px is not None
        assert measured == pytest.approx(world.local_px, rel=0.12, abs=0.002), (seed, LOCAL_PX)


def test_scale_and_drift_move_a_plane_as_far_as_they_say() -> None:
    for noise in (
        replace(PERFECT, scale=1.01),
        replace(PERFECT, drift_px=0.4),
        replace(PERFECT, scale=0.99, drift_px=-0.2),
    ):
        disparity = _measured(np.full(SIZE, 0.45), noise)
        seen_m = FOCAL * BASELINE_M / np.nanmedian(disparity)
        expected_m = noise.seen_m(0.45, focal_px=FOCAL)
        assert seen_m == pytest.approx(expected_m, abs=0.45**2 / (FOCAL * BASELINE_M) / 64)
        assert noise.true_m(expected_m, focal_px=FOCAL) == pytest.approx(0.45, abs=1e-12)
    assert replace(PERFECT, drift_px=0.1).seen_m(0.345, focal_px=FOCAL) == pytest.approx(0.345 - 0.001, abs=1e-4)


def test_islands_are_5_to_50_px_off_and_as_many_as_asked_for() -> None:
    disparity = _measured(np.full(SIZE, 0.20), replace(PERFECT, islands=400.0))
    off = np.abs(disparity - np.nanmedian(disparity))
    wrong = off[(off > 1) & np.isfinite(off)]
    assert wrong.min() > 4.9
    assert 25 < wrong.max() < 50.1
    share = wrong.size / np.isfinite(off).sum()
    assert 0.005 < share < 0.10  # 31 spots of 1.5 to 12 px radius expected on 320 x 240


def test_the_field_bows_and_neither_shifts_nor_tilts(rng: np.random.Generator) -> None:
    field = bowed_field(rng, height=480, width=848)
    v, u = np.mgrid[-1:1:480j, -1:1:848j]
    assert field.std() == pytest.approx(1.0, abs=1e-4)
    for term in (np.ones_like(u), u, v):
        assert abs((field * term).mean()) < 0.01
    assert np.abs(np.diff(field, axis=1)).max() < 0.1  # slower than 40 px
    bowed = _measured(np.full(SIZE, 0.45), replace(PERFECT, bow_px=0.3), bow=field[: SIZE[0], : SIZE[1]])
    flat = _measured(np.full(SIZE, 0.45), PERFECT)
    difference = (bowed - flat)[np.isfinite(bowed) & np.isfinite(flat)]
    np.testing.assert_allclose(
        difference, 0.3 * field[: SIZE[0], : SIZE[1]][np.isfinite(bowed) & np.isfinite(flat)], atol=0.04
    )


def test_outlines_lose_depth_on_all_four_sides() -> None:
    true = np.full(SIZE, 20.0, np.float32)
    true[80:160, 120:220] = 26.0
    lost = lost_outlines(true, np.zeros(SIZE, np.float32), near_px=2.0, far_px=10.0)
    for inside, outside in (
        (lost[120, 120:170], lost[120, :120][::-1]),
        (lost[120, 170:220][::-1], lost[120, 220:]),
        (lost[80:120, 170], lost[:80, 170][::-1]),
        (lost[120:160, 170][::-1], lost[160:, 170]),
    ):
        assert np.argmin(inside) == 2
        assert np.argmin(outside) == 10
    assert lost.mean() < 0.10
    assert not lost_outlines(np.full(SIZE, 20.0, np.float32), np.zeros(SIZE, np.float32), near_px=2, far_px=9).any()


def test_poses_are_named_by_their_axes() -> None:
    flat = np.eye(3)
    on_end = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    on_edge = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    assert [pose_of(turn).kind for turn in (flat, on_end, on_edge)] == ["flat", "standing", "tilted"]
    assert pose_of(flat).longest_deg == pytest.approx(90)
    assert pose_of(on_end).longest_deg == pytest.approx(0)


def test_what_is_lost_at_the_rim_and_on_the_skin_are_told_apart() -> None:
    rows, columns = np.ogrid[:100, :100]
    far = np.hypot(rows - 50, columns - 50)
    silhouette = far <= 40
    seen = (far <= 38) & (far > 8)
    rim = rim_of(seen, silhouette)
    assert rim.lost == pytest.approx(1 - 38**2 / 40**2, abs=0.01)
    assert rim.skin_lost == pytest.approx(8**2 / 38**2, abs=0.01)
    assert [rim_of(far <= radius, silhouette).kind for radius in (41, 40, 39, 37)] == ["exact", "exact", "good", "poor"]
