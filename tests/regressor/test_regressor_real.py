"""The one real tuber at hand, R9-9 of 3DPotatoTwin: its cloud, its pixels, where it lay and what it weighs."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from conveyor.formats.clouds import read_cloud
from conveyor.resting import POTATOTWIN
from regressor.studies.resting import measure_resting
from regressor.weigh.files import FileOptions, prepare_file, weigh_file
from regressor.weigh.weigher import Weigher

SAMPLE = Path(os.environ.get("TUBERLINE_SHARED", "../shared")) / "data" / "potatotwin_sample"
CLOUD = SAMPLE / "R9-9_pcd_365.ply"
DEPTH = SAMPLE / "derived" / "R9-9_pcd_365_depth_z16_mm.png"
OPTIONS = FileOptions(0.345, intrinsics=SAMPLE / "realsense_d405_intrinsic.json")
TRUE_G = 108.0

pytestmark = pytest.mark.skipif(not CLOUD.is_file(), reason=f"{CLOUD} is not there: set TUBERLINE_SHARED")


def test_its_cloud_has_the_volume_of_its_pixels() -> None:
    cloud, pixels = (prepare_file(path, OPTIONS) for path in (CLOUD, DEPTH))
    assert cloud.surface.volume_ml == pytest.approx(pixels.surface.volume_ml, rel=0.02)
    assert cloud.surface.area_cm2 == pytest.approx(pixels.surface.area_cm2, rel=0.02)
    assert cloud.height_m == pytest.approx(pixels.height_m, abs=1e-6)


def test_it_lay_below_the_stated_belt() -> None:
    """Twelve starts of the 150 behind the constant: the offset within its uncertainty."""
    seed = 4
    fit = measure_resting(
        read_cloud(CLOUD), read_cloud(SAMPLE / "R9-9_20000.ply"), belt_distance_m=0.345, starts=12, seed=seed
    )
    print_out = f"seed {seed}: {1e3 * fit.offset_m:.2f} mm, sd {1e3 * fit.sd_m:.2f} mm"
    assert fit.offset_m == pytest.approx(POTATOTWIN.offset_m, abs=2 * POTATOTWIN.sd_m), print_out
    assert 0.0 < fit.sd_m < 0.003, print_out
    assert fit.optima[0].rms_m < 0.0008, print_out


def test_with_its_resting_level_it_weighs_right() -> None:
    level = POTATOTWIN
    options = FileOptions(
        0.345, intrinsics=OPTIONS.intrinsics, resting_offset_m=level.offset_m, resting_sd_m=level.sd_m
    )
    for path in (CLOUD, DEPTH):
        weighed = weigh_file(path, options, Weigher.load()).weighed
        assert weighed is not None
        assert weighed.weight_g == pytest.approx(TRUE_G, rel=0.08)
        assert weighed.low_g < TRUE_G < weighed.high_g
        on_belt = weigh_file(path, OPTIONS, Weigher.load()).weighed
        assert on_belt is not None
        assert on_belt.weight_g < weighed.weight_g


def test_a_body_of_known_place_is_found_again() -> None:
    """A lumpy ellipsoid 4 mm under the belt, seen from above with 0.3 mm of noise: found within 0.5 mm."""
    rng = np.random.default_rng(11)
    unit = rng.normal(size=(12_000, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    body = unit * [0.036, 0.030, 0.026] * (1 + 0.08 * np.sin(3 * unit[:, :1] + 1) + 0.06 * np.cos(4 * unit[:, 1:2]))
    placed = body @ Rotation.from_euler("xyz", [0.2, 0.4, 1.1]).as_matrix().T
    placed += [0.02, -0.03, 0.345 + 0.004 - placed[:, 2].max()]
    middle = placed.mean(0)
    # What faces the camera and is no lower than a little above the equator, as real masks end.
    seen = placed[((placed - middle) @ (-middle) > 0) & (placed[:, 2] < middle[2] - 0.004)]
    seen = seen + rng.normal(0, 3e-4, seen.shape)
    fit = measure_resting(seen, body, belt_distance_m=0.345, starts=16, seed=2)
    assert fit.offset_m == pytest.approx(0.004, abs=0.0005)
