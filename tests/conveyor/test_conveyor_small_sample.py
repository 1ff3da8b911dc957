"""Intervals from small samples cover what they say, as often as they say."""

from __future__ import annotations

import numpy as np
import pytest

from conveyor.small_sample import holding_half_width, holding_rank


@pytest.mark.parametrize("n", [22, 50, 100, 300])
def test_nine_of_ten_calibrations_cover_nine_of_ten_tubers(n: int) -> None:
    """Errors are uniform here, so an interval's coverage is its own half-width; seed 17."""
    rank = holding_rank(n)
    assert rank is not None
    coverage = np.sort(np.random.default_rng(17).random((4000, n)), axis=1)[:, rank - 1]
    assert 0.885 <= (coverage >= 0.9).mean() <= 0.995
    if n >= 100:  # and no wider than needed: one rank less would not hold
        tighter = np.sort(np.random.default_rng(17).random((4000, n)), axis=1)[:, rank - 2]
        assert (tighter >= 0.9).mean() < 0.905


def test_the_plain_conformal_level_holds_in_half_of_all_calibrations_only() -> None:
    """Why the rank is chosen for the small sample: at n = 50 one plain calibration in 20 covers less than .826."""
    plain = np.sort(np.random.default_rng(3).random((4000, 50)), axis=1)[:, int(np.ceil(51 * 0.9)) - 1]
    assert (plain >= 0.9).mean() < 0.7
    assert np.quantile(plain, 0.05) == pytest.approx(0.826, abs=0.01)


def test_too_few_say_nothing_and_the_width_is_that_of_the_rank() -> None:
    assert holding_rank(21) is None
    assert holding_half_width([0.1] * 21) is None
    assert holding_rank(22) == 22
    errors = [(-1) ** n * n / 100 for n in range(22)]
    assert holding_half_width(errors) == pytest.approx(0.21)
