"""Tubers that two cameras see, found by their places alone."""

from __future__ import annotations

import numpy as np
import pytest

from conveyor.common_places import Places, common_offset

REACH = {"along_m": 0.5, "across_m": 1.0}


def tubers(
    rng: np.random.Generator, n: int, *, belt_m: float = 3.0, low_m: float = -0.5, high_m: float = 0.5
) -> Places:
    xy_m = rng.uniform([-belt_m, low_m], [0.0, high_m], (n, 2))
    return Places(xy_m, rng.normal(45, 8, n), np.exp(rng.normal(4.8, 0.5, n)))


def part(
    of: Places, kept: np.ndarray, rng: np.random.Generator, *, moved_m: tuple[float, float] = (0.0, 0.0)
) -> Places:
    """As one camera sees some of them: places off by 1.5 mm, heights by 1 mm, sizes by 5 %."""
    n = int(kept.sum())
    xy_m = of.xy_m[kept] + np.array(moved_m) + rng.normal(0, 0.0015, (n, 2))
    return Places(xy_m, of.height_mm[kept] + rng.normal(0, 1, n), of.size[kept] * np.exp(rng.normal(0, 0.05, n)))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("moved_m", [(0.0, 0.0), (0.02, -0.045), (-0.31, 0.62)])
def test_the_offset_of_two_cameras_that_share_a_fifth_of_the_belt(seed: int, moved_m: tuple[float, float]) -> None:
    rng = np.random.default_rng(seed)
    belt = tubers(rng, 150)
    left = part(belt, belt.xy_m[:, 1] < 0.1, rng)
    right = part(belt, belt.xy_m[:, 1] > -0.1, rng, moved_m=moved_m)
    shared = int(np.count_nonzero(np.abs(belt.xy_m[:, 1]) < 0.1))
    found = common_offset(left, right, **REACH)
    assert found is not None
    assert (found.along_m, found.across_m) == pytest.approx(moved_m, abs=0.0025)
    assert 0.8 * shared <= len(found.pairs) <= shared + 2
    assert len(set(found.pairs[:, 0].tolist())) == len(set(found.pairs[:, 1].tolist())) == len(found.pairs)
    assert found.along_sd_m < 0.002
    assert abs(found.higher_mm) < 1.5


@pytest.mark.parametrize("seed", range(20))
def test_cameras_that_share_nothing_are_not_laid_over_each_other(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    assert common_offset(tubers(rng, 150), tubers(rng, 150), **REACH) is None


@pytest.mark.parametrize("seed", range(5))
def test_even_rows_of_tubers_that_are_all_alike_say_nothing(seed: int) -> None:
    """They match at every distance between two rows."""
    rng = np.random.default_rng(200 + seed)
    xy_m = np.array([(-0.06 * i, 0.06 * j) for i in range(40) for j in range(5)])
    xy_m += rng.normal(0, 0.001, xy_m.shape)
    rows = Places(xy_m, rng.normal(45, 1, len(xy_m)), np.full(len(xy_m), 120.0))
    left, right = rows.xy_m[:, 1] < 0.13, rows.xy_m[:, 1] > 0.11
    assert common_offset(part(rows, left, rng), part(rows, right, rng), **REACH) is None


@pytest.mark.parametrize("n", [0, 1, 6])
def test_few_tubers_tell_nothing(n: int) -> None:
    rng = np.random.default_rng(3)
    belt = tubers(rng, 40)
    few = part(belt, np.arange(40) < n, rng)
    assert common_offset(few, belt, **REACH) is None
    assert common_offset(belt, few, **REACH) is None
