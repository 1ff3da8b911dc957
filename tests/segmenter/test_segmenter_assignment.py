"""Tracks and instances are assigned as SciPy's solver assigns them, ties included."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from segmenter.track.assignment import least_cost_pairs
from segmenter.track.tracker import NO_MATCH


@pytest.mark.parametrize("seed", range(40))
def test_pairs_are_those_of_scipy(seed: int) -> None:
    """Costs of a few sizes, many of them equal, most of them out of reach: as between tracks and instances."""
    rng = np.random.default_rng(seed)
    cost = rng.random(rng.integers(1, 30, 2)) if seed % 2 else rng.integers(0, 4, rng.integers(1, 30, 2)).astype(float)
    cost[rng.random(cost.shape) < rng.choice([0.0, 0.5, 0.9])] = NO_MATCH
    rows, columns = linear_sum_assignment(cost)
    assert least_cost_pairs(cost) == list(zip(rows.tolist(), columns.tolist(), strict=True))


@pytest.mark.parametrize("shape", [(0, 3), (4, 0)])
def test_nothing_has_no_pairs(shape: tuple[int, int]) -> None:
    assert least_cost_pairs(np.zeros(shape)) == []
