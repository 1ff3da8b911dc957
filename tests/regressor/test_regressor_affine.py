"""The second stage by affine rows gives what the plain form gives, wherever its units change."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from regressor.network import affine
from regressor.network.affine import AFFINE_ROWS, MOST_ROWS, AffineStage
from regressor.network.affine_loops import behind_relu
from regressor.network.fast import FastPointRaft
from regressor.network.grouping import SharedGroups, group_prefix
from regressor.network.products import Array, Folded
from regressor.network.stored import load_weights
from regressor.weigh.prepare import prepare_view
from tests.regressor.ellipsoids import ellipsoid_view


def stage(rng: np.random.Generator, slope: float) -> Folded:
    """A set abstraction of made-up weights; its units feel a neighbour's place `slope` times as much as a feature."""
    sizes = ((40, 19), (30, 40), (50, 30))
    weights = [rng.normal(0, size[1] ** -0.5, size).astype(np.float32) for size in sizes]
    weights[0][:, -3:] *= slope
    return Folded(tuple(weights), tuple(rng.normal(0, 0.2, len(w)).astype(np.float32) for w in weights))


def plain(mlp: Folded, inputs: Array, centroids: Array) -> NDArray[np.float64]:
    """(C, O) by every edge, in float64."""
    first, second, third = (weight.astype(np.float64) for weight in mlp.weights)
    edges = (inputs @ first.T + mlp.biases[0])[None] - (centroids @ first[:, -3:].T)[:, None]
    hidden = np.maximum(np.maximum(edges, 0) @ second.T + mlp.biases[1], 0)
    pooled: NDArray[np.float64] = (hidden @ third.T).max(axis=1) + mlp.biases[2]
    return pooled


def neighbours_and_centroids(rng: np.random.Generator) -> tuple[Array, Array]:
    places = rng.uniform(-0.04, 0.04, (64, 3))
    features = np.maximum(rng.normal(0, 1, (64, 16)), 0)
    centroids = rng.uniform(-0.04, 0.04, (128, 3)) + np.array([0.3, -0.1, 0.0])
    return np.concatenate([features, places], axis=1).astype(np.float32), centroids.astype(np.float32)


@pytest.mark.parametrize("slope", [0.0, 0.3, 3.0, 30.0])
def test_values_are_those_of_every_edge(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, slope: float
) -> None:
    """Also where it does not pay, because most units change."""
    monkeypatch.setattr(affine, "MOST_ROWS", 1000)
    mlp, (inputs, centroids) = stage(rng, slope), neighbours_and_centroids(rng)
    pooled = AffineStage(mlp).pooled(inputs, centroids)
    assert pooled is not None
    np.testing.assert_allclose(pooled, plain(mlp, inputs, centroids), rtol=0, atol=2e-6)


@pytest.mark.parametrize("centroids", [1, 2, 128])
def test_any_number_of_centroids_will_do_also_all_in_one_place(rng: np.random.Generator, centroids: int) -> None:
    mlp, (inputs, places) = stage(rng, 3.0), neighbours_and_centroids(rng)
    for places_used in (places[:centroids], np.repeat(places[:1], centroids, axis=0)):
        pooled = AffineStage(mlp).pooled(inputs, places_used)
        assert pooled is not None
        np.testing.assert_allclose(pooled, plain(mlp, inputs, places_used), rtol=0, atol=2e-6)


def test_a_unit_that_changes_gets_a_row_and_one_that_sleeps_none() -> None:
    """One neighbour: its units are awake, asleep, and awake for one of two centroids."""
    rows = np.array([[1.0, -1.0, 0.1], [0.5, 0.5, 1.0]], np.float32)
    basis = np.array([[1.0, 1.0], [1.0, -1.0]], np.float32)
    behind, values, begin = behind_relu(rows, basis, np.array([0, 2]))
    np.testing.assert_array_equal(behind, np.array([[1.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.0, 0.0, 1.0]], np.float32))
    np.testing.assert_array_equal(values, np.array([[1.0, 1.0], [1.0, -1.0], [1.1, 0.0]], np.float32))
    assert begin.tolist() == [0, 3]


def test_where_most_units_change_the_plain_form_is_asked(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    mlp, (inputs, centroids) = stage(rng, 300.0), neighbours_and_centroids(rng)
    assert AffineStage(mlp).pooled(inputs, centroids) is None
    groups, network = shipped()
    by_rows = network.weigh(groups, 0.05)
    monkeypatch.setattr(affine, "MOST_ROWS", AFFINE_ROWS - 1)
    by_edges = network.weigh(groups, 0.05)
    assert by_rows == pytest.approx(by_edges, rel=2e-6)


def test_the_shipped_networks_units_hardly_change() -> None:
    """It is what the form is fast by: 8 rows of a neighbour at most, in place of 128."""
    groups, network = shipped()
    counted = []

    def counting(rows: Array, basis: Array, begin: NDArray[np.int64]) -> tuple[Array, Array, NDArray[np.int64]]:
        out = behind_relu(rows, basis, begin)
        counted.append(len(out[0]) / len(groups.neighbours))
        return out

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(affine, "behind_relu", counting)
        network.weigh(groups, 0.05)
    assert len(counted) == 2
    assert AFFINE_ROWS < counted[1] < MOST_ROWS / 2
    turned = replace(groups, centroids2=groups.centroids2[::-1])
    assert network.weigh(turned, 0.05) == pytest.approx(network.weigh(groups, 0.05), rel=1e-6)


def shipped() -> tuple[SharedGroups, FastPointRaft]:
    """A tuber's groups, and the network that ships."""
    groups = group_prefix(prepare_view(ellipsoid_view((0.05, 0.034, 0.028))).points)
    assert isinstance(groups, SharedGroups)
    return groups, FastPointRaft(load_weights()[0])
