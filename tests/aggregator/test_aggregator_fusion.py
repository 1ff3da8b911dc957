"""Fusion: laws of the mean and its interval, and what happens without any weighed view."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aggregator.core.fusion import SHARED_SHARE, VOLUME_G_PER_ML, fuse
from conveyor.messages import WeighedView
from conveyor.statistics import NORMAL_90


def view(weight_g: float, *, half_g: float = 30.0, n: int = 0, method: str = "pointraft") -> WeighedView:
    return WeighedView(f"t/{n}", n, weight_g, weight_g - half_g, weight_g + half_g, method, "m1", ())  # type: ignore[arg-type]


def fused(*views: WeighedView, volumes: tuple[float, ...] = (150.0,)):
    return fuse(views, visible_volumes_ml=volumes, axes_mm=(70, 60, 50))


def test_one_view_is_taken_as_it_is() -> None:
    result = fused(view(150))
    assert (result.weight_g, result.low_g, result.high_g) == pytest.approx((150, 120, 180))
    assert (result.views, result.method, result.model, result.flags) == (1, "pointraft", "m1", ())


def test_the_interval_shrinks_as_measured_and_not_as_one_over_root_n() -> None:
    """31 views cut the error by 13 %, 7 by 10 % (docs/ledger.md)."""
    for n, least, most in ((7, 0.88, 0.92), (31, 0.86, 0.89)):
        result = fused(*(view(150, n=i) for i in range(n)))
        assert least < (result.high_g - result.low_g) / 60 < most
    many = fused(*(view(150, n=i) for i in range(10_000)))
    assert (many.high_g - many.low_g) / 60 == pytest.approx(math.sqrt(SHARED_SHARE), rel=1e-3)


@given(st.lists(st.floats(20, 600), min_size=1, max_size=9), st.permutations(range(9)))
def test_the_order_of_views_changes_nothing(weights: list[float], order: list[int]) -> None:
    views = [view(weight, n=i) for i, weight in enumerate(weights)]
    assert fused(*views) == fused(*(views[i] for i in order if i < len(views)))


@given(st.lists(st.floats(100, 140), min_size=1, max_size=9), st.floats(0.5, 3))
def test_weights_scale_with_their_views(weights: list[float], factor: float) -> None:
    once = fused(*(view(w, half_g=0.2 * w, n=i) for i, w in enumerate(weights)))
    more = fused(*(view(factor * w, half_g=0.2 * factor * w, n=i) for i, w in enumerate(weights)))
    assert more.weight_g == pytest.approx(factor * once.weight_g)
    assert more.high_g - more.low_g == pytest.approx(factor * (once.high_g - once.low_g))


@given(st.lists(st.tuples(st.floats(20, 600), st.floats(1, 200)), min_size=1, max_size=9))
def test_the_mean_lies_among_its_views_and_inside_its_interval(given_views: list[tuple[float, float]]) -> None:
    result = fused(*(view(w, half_g=h, n=i) for i, (w, h) in enumerate(given_views)))
    weights = [w for w, _ in given_views]
    assert min(weights) - 1e-9 <= result.weight_g <= max(weights) + 1e-9
    assert 0 <= result.low_g <= result.weight_g <= result.high_g


@pytest.mark.parametrize("n", [3, 4, 5, 7])
def test_one_outlier_among_three_or_more_changes_nothing(n: int) -> None:
    good = [view(150 + i, n=i) for i in range(n - 1)]
    result = fused(*good, view(420, n=99))
    assert result.weight_g == pytest.approx(fused(*good).weight_g)
    assert result.views == n - 1
    assert "outlier_view" in result.flags


def test_two_views_that_disagree_are_both_kept_and_the_interval_says_so() -> None:
    result = fused(view(100, n=0), view(300, n=1))
    assert result.weight_g == pytest.approx(200)
    assert result.views == 2
    assert result.high_g - result.low_g > 2 * 60


def test_sharper_views_count_more() -> None:
    assert fused(view(100, half_g=10, n=0), view(130, half_g=30, n=1)).weight_g == pytest.approx(103)


def test_views_by_volume_give_way_to_the_network() -> None:
    result = fused(view(150, n=0), view(90, n=1, method="volume"))
    assert (result.weight_g, result.method, result.views) == (150, "pointraft", 1)
    assert fused(view(90, method="volume")).method == "volume"


def test_without_a_view_the_volume_decides_with_a_wide_interval() -> None:
    result = fused(volumes=(100.0, 200.0, 140.0))
    assert result.weight_g == pytest.approx(VOLUME_G_PER_ML * 140)
    assert (result.high_g - result.low_g) / result.weight_g > 0.39
    assert (result.method, result.views, result.model) == ("volume", 0, "")
    assert "no_view_weighed" in result.flags


def test_without_a_volume_the_axes_decide_and_without_those_the_mean_of_all_tubers() -> None:
    assert fuse([], visible_volumes_ml=[0.0], axes_mm=(76.3, 62.5, 51.9)).weight_g == pytest.approx(153.7, abs=0.1)
    nothing = fuse([], visible_volumes_ml=[], axes_mm=(0, 0, 0))
    assert nothing.low_g < nothing.weight_g < nothing.high_g
    assert "never_measured" in nothing.flags


def test_the_interval_holds_its_promise_for_errors_shared_by_a_tubers_views(rng: np.random.Generator) -> None:
    """90 % of tubers within the interval, with errors made as the constant says."""
    sd_g, hits, n = 18.0, 0, 4000
    for _ in range(n):
        shared = rng.normal(0, sd_g * math.sqrt(SHARED_SHARE))
        own = rng.normal(0, sd_g * math.sqrt(1 - SHARED_SHARE), 5)
        result = fused(*(view(170 + shared + e, half_g=NORMAL_90 * sd_g, n=i) for i, e in enumerate(own)))
        hits += result.low_g <= 170 <= result.high_g
    assert 0.885 < hits / n < 0.93
