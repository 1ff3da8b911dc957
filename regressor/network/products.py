"""The wide products of the fast form: what they take, and by NumPy in float32.

In bfloat16 they are `regressor.network.rounded`'s.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from regressor.network.architecture import NEIGHBOURS, NORM_EPSILON
from regressor.network.edges import add_bias_relu, edge_differences, live_units, pooled_maximum
from regressor.network.stored import State

BLOCK_CENTROIDS = 32
LIVE_STEP = 32
"""See `live_units`."""
Array = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Folded:
    """Weights (out, in) and biases (out,) of a shared MLP with its batch norms folded in."""

    weights: tuple[Array, ...]
    biases: tuple[Array, ...]


class Wide(Protocol):
    """The wide products of a network, in one precision. Several threads may use one instance."""

    def abstract(self, stage: int, sources: list[Array], centroids: Array, out: Array) -> None:
        """The maximum over the neighbours of each centroid, without the last bias.

        Args:
            stage: the first set abstraction, 0, or the second, 1.
            sources: (K, W) first layer of the neighbours, one for all centroids or one for each.
            centroids: (C, W) what the first layer makes of each centroid. out: (C, O) float32, is written.
        """

    def describe(self, rows: Array) -> Array:
        """(1024,) the last stage of (C, 259) rows, without its last bias."""


def folded(state: State, name: str) -> Folded:
    """The shared MLP `name` of a network, each batch norm folded into the linear layer before it, in float64."""
    weights, biases, index = [], [], 0
    while f"{name}.lins.{index}.weight" in state:
        weight, bias = (state[f"{name}.lins.{index}.{part}"].astype(np.float64) for part in ("weight", "bias"))
        norm = f"{name}.norms.{index}.module"
        if f"{norm}.weight" in state:
            scale, shift, mean, variance = (
                state[f"{norm}.{part}"].astype(np.float64) for part in ("weight", "bias", "running_mean", "running_var")
            )
            scale = scale / np.sqrt(variance + NORM_EPSILON)
            weight, bias = weight * scale[:, None], (bias - mean) * scale + shift
        weights.append(weight.astype(np.float32))
        biases.append(bias.astype(np.float32))
        index += 1
    return Folded(tuple(weights), tuple(biases))


class PlainProducts:
    """Float32 by NumPy."""

    def __init__(self, stages: list[Folded]) -> None:
        self._stages = stages
        # (I, O) each: of these the rows of live units are picked.
        self._last_two = [np.ascontiguousarray(weight.T) for weight in stages[2].weights[1:]]
        self._room = Room(np.float32)

    def abstract(self, stage: int, sources: list[Array], centroids: Array, out: Array) -> None:
        """As `Wide` says."""
        mlp, rows = self._stages[stage], len(centroids) * NEIGHBOURS
        edges, hidden, values = (self._room.of(stage, layer, rows, len(bias)) for layer, bias in enumerate(mlp.biases))
        differences(sources, centroids, edges, edge_differences)
        np.matmul(edges, mlp.weights[1].T, out=hidden)
        add_bias_relu(hidden, mlp.biases[1])
        np.matmul(hidden, mlp.weights[2].T, out=values)
        pooled_maximum(values, out)

    def describe(self, rows: Array) -> Array:
        """As `Wide` says."""
        mlp = self._stages[2]
        x = rows @ mlp.weights[0].T
        add_bias_relu(x, mlp.biases[0])
        x = self._live(x, 0)
        add_bias_relu(x, mlp.biases[1])
        described: Array = self._live(x, 1).max(axis=0)
        return described

    def _live(self, x: Array, layer: int) -> Array:
        """(R, O) product of activations (R, I) and one of the last two layers' weights, by the live units."""
        columns, rows = live_units(x.view(np.int32), self._last_two[layer].view(np.int32), LIVE_STEP)
        product: Array = columns.view(np.float32) @ rows.view(np.float32)
        return product


def differences(sources: list[Array], centroids: Array, edges: NDArray[Any], kernel: Any) -> None:
    """ReLU of each neighbour's first layer less its centroid's, into (C * K, W) `edges`, by a kernel of `edges`."""
    if len(sources) == 1:
        kernel(sources[0], centroids, edges)
        return
    for row, source in enumerate(sources):
        kernel(source, centroids[row : row + 1], edges[row * NEIGHBOURS : (row + 1) * NEIGHBOURS])


class Room(threading.local):
    """Room for one block, kept from cloud to cloud. Each thread has its own: it writes while it weighs."""

    def __init__(self, kind: type[np.float32] | type[np.uint16]) -> None:
        self._kind = kind
        self._made: dict[tuple[int, int], NDArray[Any]] = {}

    def of(self, stage: int, layer: int, rows: int, width: int) -> NDArray[Any]:
        """(rows, width) for what a stage's layer gives; what stood there before is not kept."""
        if (stage, layer) not in self._made:
            self._made[stage, layer] = np.empty((BLOCK_CENTROIDS * NEIGHBOURS, width), self._kind)
        return self._made[stage, layer][:rows]
