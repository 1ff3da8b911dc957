"""Rounded parts add up to their rounded sum, whatever they are."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from conveyor.rounding import rounded_to_sum


@given(
    parts=st.lists(st.floats(0, 1e6, allow_nan=False, allow_subnormal=False), max_size=12),
    digits=st.integers(0, 2),
)
def test_parts_add_up_and_none_is_off_by_a_whole_step(parts: list[float], digits: int) -> None:
    told, step = rounded_to_sum(parts, digits=digits), 10.0**-digits
    assert sum(told) == pytest.approx(round(sum(parts) / step) * step, abs=1e-6)
    assert all(abs(a - b) < step * (1 + 1e-6) for a, b in zip(told, parts, strict=True))


@pytest.mark.parametrize(
    ("parts", "digits", "told"),
    [
        ([3.5, 12.5, 49.6, 46.4, 38.0], 0, [4, 12, 50, 46, 38]),
        ([33.34, 33.33, 33.33], 1, [33.4, 33.3, 33.3]),
        ([99.96, 0.02, 0.02], 1, [100.0, 0.0, 0.0]),
        ([0.1, 0.2, 0.3, 99.4], 1, [0.1, 0.2, 0.3, 99.4]),
        ([7.0], 0, [7]),
        ([], 0, []),
    ],
)
def test_the_largest_remainders_are_rounded_up(parts: list[float], digits: int, told: list[float]) -> None:
    assert rounded_to_sum(parts, digits=digits) == told
