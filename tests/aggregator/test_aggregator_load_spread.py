"""What a load's tubers share: the ledger and the evaluation of weights state the same width before any ticket."""

from __future__ import annotations

import math

import pytest

from aggregator.calibration.apply import calibrated
from aggregator.calibration.correction import Prior, prior_told
from conveyor.load_spread import (
    DENSITY_SD,
    DRIFT_SD,
    FACTOR_SD,
    OFFSET_SD_MM,
    OTHER_CAMERA_SD,
    SCALE_SD,
    SHARE_PER_MM,
    shared_sd_share,
)


@pytest.mark.parametrize("offset_sd_mm", [0.3, 1.5, OFFSET_SD_MM])
def test_ledger_and_evaluation_state_the_same_width(offset_sd_mm: float) -> None:
    found = calibrated(
        {("pointraft", "m"): 10_000.0},
        per_mm_g=SHARE_PER_MM * 10_000.0,
        own_variance_g2=(0.0, 0.0),
        prior=Prior(offset_sd_mm=offset_sd_mm),
    )
    assert found.high_sd_g / found.weight_g == pytest.approx(shared_sd_share(offset_sd_mm), rel=1e-6)


def test_what_is_known_of_the_camera_decides_the_width_before_any_ticket() -> None:
    """Rods in view know the drift; a camera unlike those trained for is doubted as a whole; the rest is in between."""
    rods, width, none = (prior_told({"gauge": gauge}).factor_sd for gauge in ("rods", "belt-width", "none"))
    assert rods < none == width == FACTOR_SD, "a width tells only what changed since the run began"
    assert none == pytest.approx(math.hypot(DENSITY_SD, SCALE_SD, DRIFT_SD))
    plain, half, whole = (shared_sd_share(1.0, other_share=share) for share in (0.0, 0.5, 1.0))
    assert plain < half < whole == pytest.approx(math.hypot(plain, OTHER_CAMERA_SD))


def test_what_is_stated_is_as_well_known_as_the_belt_plane_above_it() -> None:
    told = {"resting_offset_mm": 5.5, "resting_sd_mm": 1.5, "plane_sd_mm": 2.0}
    assert prior_told(told) == Prior(5.5, offset_sd_mm=2.5)
    assert prior_told({**told, "plane_sd_mm": 0.0}) == Prior(5.5, offset_sd_mm=1.5)
    assert prior_told({**told, "plane_sd_mm": 80.0}).offset_sd_mm == OFFSET_SD_MM, "never worse than not stated"
    assert prior_told({**told, "resting_sd_mm": 6.0}).offset_sd_mm == 6.0, "but as badly as the line itself says"
    assert prior_told({}) == prior_told({"resting_offset_mm": 0.0, "resting_sd_mm": None}) == Prior()
