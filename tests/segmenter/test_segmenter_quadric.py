"""What departs from an ellipsoid and what does not, whichever way it lies."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from segmenter.classify.patch import CELL_MM, SIZE
from segmenter.classify.quadric import FEWEST, departures

SEED = 5102


def seen_from_above(half_mm: tuple[float, float, float], rotation: NDArray[np.float64]) -> NDArray[np.float32]:
    """(48, 48) heights of an ellipsoid that rests on the belt, millimetres; 0 beside it."""
    inverse = rotation @ np.diag(1 / np.square(half_mm)) @ rotation.T
    x, y = ((np.mgrid[:SIZE, :SIZE] - SIZE / 2 + 0.5) * CELL_MM).astype(np.float64)
    a = inverse[2, 2]
    b = 2 * (inverse[0, 2] * x + inverse[1, 2] * y)
    c = inverse[0, 0] * x * x + 2 * inverse[0, 1] * x * y + inverse[1, 1] * y * y - 1
    under = b * b - 4 * a * c
    lowest = np.sqrt(np.linalg.inv(inverse)[2, 2])
    height = (-b + np.sqrt(np.maximum(under, 0))) / (2 * a) + lowest
    return np.where(under > 0, height, 0).astype(np.float32)


def test_an_ellipsoid_departs_from_none_whichever_way_it_lies() -> None:
    rng = np.random.default_rng(SEED)
    for rotation in Rotation.random(20, rng=rng):
        half_mm = tuple(rng.uniform(16, 42, 3).tolist())
        height = seen_from_above(half_mm, rotation.as_matrix())
        share = (height > 0).astype(np.float32)
        departure = departures(height[None], share[None])[0]
        # The rim is steep: the ridge that keeps flat bodies solvable shows there, and nowhere else.
        assert np.percentile(np.abs(departure[share > 0]), 90) < 0.15, (SEED, half_mm)
        assert np.abs(departure).max() < 3.0, (SEED, half_mm)
        assert (departure[share == 0] == 0).all()


def test_a_knob_stands_out_by_about_its_height_and_nothing_else_does() -> None:
    height = seen_from_above((35.0, 28.0, 24.0), np.eye(3))
    share = (height > 0).astype(np.float32)
    i, j = np.mgrid[:SIZE, :SIZE]
    knob = 4.0 * np.exp(-((i - 28) ** 2 + (j - 20) ** 2) / (2 * 2.5**2))
    departure = departures((height + share * knob)[None].astype(np.float32), share[None])[0]
    assert departure[28, 20] == pytest.approx(4.0, abs=1.2)
    far = (height > 24) & (knob < 0.1)
    assert np.abs(departure[far]).mean() < 0.6


def test_too_little_of_a_body_says_nothing() -> None:
    height = np.full((1, SIZE, SIZE), 20, np.float32)
    share = np.zeros((1, SIZE, SIZE), np.float32)
    share[0].ravel()[: FEWEST - 1] = 1
    assert (departures(height, share) == 0).all()
    flat = departures(height, np.ones_like(share))
    assert np.isfinite(flat).all()
