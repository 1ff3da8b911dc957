"""A load whose camera is doubtful is as wide as that makes it; the ledger's flags say why."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from aggregator.calibration.apply import OFF_SD_PER_MM
from aggregator.calibration.correction import Prior, prior_told
from aggregator.core.load_sums import CameraDoubt, LoadSums
from aggregator.core.totals import LoadTotals
from conveyor.camera_flags import BELT_DISTANCE, CAMERA_NOISE, CAMERA_UNLIKE, RODS_UNSEEN, belt_off_flag
from conveyor.load_spread import OTHER_CAMERA_SD
from conveyor.messages import Tuber
from conveyor.statistics import NORMAL_90

TUBER = Tuber(1, "r", 0, 0, 0, 170.0, 140.0, 200.0, 70, 60, 50, 3, "pointraft", "m", (), ("a",), ("t",))


def _load(*flags: tuple[str, ...]) -> LoadSums:
    """A hundred tubers for each tuple of flags."""
    sums = LoadSums(50.0)
    for one in flags:
        for _ in range(100):
            sums.add(replace(TUBER, flags=one))
    return sums


def _half_width(sums: LoadSums, prior: Prior | None = None) -> float:
    low_g, high_g = LoadTotals(sums, prior=prior).interval_g()
    return (high_g - low_g) / 2 / LoadTotals(sums, prior=prior).weight_g


def test_noise_beyond_the_trained_range_widens_by_its_share() -> None:
    plain = _half_width(_load((), ()))
    both = (CAMERA_NOISE, CAMERA_UNLIKE)
    for flags, share in (
        ((), 0.0),
        (("cut",), 0.0),
        ((CAMERA_NOISE,), 0.5),
        ((CAMERA_UNLIKE,), 0.5),
        (both, 0.5),
        ((BELT_DISTANCE,), 0.5),
    ):
        wide = _half_width(_load((), flags))
        assert wide == pytest.approx(math.hypot(plain, NORMAL_90 * OTHER_CAMERA_SD * share), rel=1e-6), flags


def test_a_belt_off_for_no_known_cause_covers_a_drift_at_any_distance() -> None:
    plain = _half_width(_load(()))
    wide = _half_width(_load(belt_off_flag(0.004)))
    assert wide == pytest.approx(math.hypot(plain, NORMAL_90 * 4 * OFF_SD_PER_MM), rel=1e-6)
    for distance_m in (0.46, 0.40):
        assert 4 / distance_m <= NORMAL_90 * OFF_SD_PER_MM * 1000, "4 d / z of a volume, d and z in metres"


def test_rods_that_no_camera_found_are_worth_no_more_than_no_gauge() -> None:
    rods, none = (prior_told({"gauge": gauge}) for gauge in ("rods", "none"))
    for flags, prior in (((), rods), ((RODS_UNSEEN,), none)):
        as_told = LoadTotals(_load(flags), prior=rods).calibrated().low_sd_g
        assert as_told == pytest.approx(LoadTotals(_load(()), prior=prior).calibrated().low_sd_g, rel=1e-9), flags
    seen, half, unseen = (
        _half_width(_load(*flags), rods) for flags in (((), ()), ((), (RODS_UNSEEN,)), ((RODS_UNSEEN,),))
    )
    assert seen < half < unseen


def test_the_parts_still_add_up_and_name_the_camera() -> None:
    message = LoadTotals(_load((CAMERA_NOISE, *belt_off_flag(0.006)))).message(
        "r", coverage=1.0, cameras={}, final=True
    )
    before = LoadTotals(_load(())).message("r", coverage=1.0, cameras={}, final=True)
    assert message.parts_percent["camera"] > before.parts_percent["camera"] + 2
    assert message.parts_percent["resting level"] == before.parts_percent["resting level"]
    whole = 100 * (message.estimated_high_g - message.estimated_low_g) / 2 / message.estimated_weight_g
    assert math.hypot(*message.parts_percent.values()) == pytest.approx(whole, abs=0.05)


def test_sums_that_are_kept_come_back_and_old_ones_without_a_camera_do_too() -> None:
    sums = _load((CAMERA_NOISE,), belt_off_flag(0.003))
    assert LoadSums.from_plain(sums.plain()).same_as(sums)
    assert sums.camera_doubt() == CameraDoubt(unlike_share=0.5, off_mm=1.5, ungauged_share=0.0)
    old = {
        name: value for name, value in _load(()).plain().items() if name not in ("noisy_g", "off_g_mm", "ungauged_g")
    }
    assert LoadSums.from_plain(old).same_as(_load(()))
