"""A set abstraction whose centroids lie close together and have the same neighbours, by few products and exactly.

What tells one of a tuber's centroids from another is where it lies, three numbers that differ by some centimetres. A
neighbour's units hardly notice: with the shipped weights 997 of 1000 are awake for all centroids or asleep for all.
Where no ReLU changes, the layers are affine in the centroid. So four rows of a neighbour go through the products, its
value at the middle of the centroids and its slopes along the axes, in place of one row for each of 128 centroids. A
unit that does change gets one row more. Of the maximum only those neighbours are evaluated that may hold it at some
centroid, 1.1 of 64 for a channel in the mean.

Nothing is left out: the values are those of the plain form, summed in another order. Which units change is told by
bounds that are rather too wide.
"""

from __future__ import annotations

import numpy as np

from regressor.network.affine_loops import behind_relu, largest
from regressor.network.products import Array, Folded

AFFINE_ROWS = 4
"""Of a neighbour: a constant and three slopes."""
MOST_ROWS = 16
"""Of a neighbour, in the mean over a cloud. On an AVX2 core the plain form is as fast from some 45 on with 128
centroids, from 8 on with 16."""


class AffineStage:
    """One set abstraction. Several threads may use one instance."""

    def __init__(self, mlp: Folded) -> None:
        """`mlp`: its three layers; the last three inputs of the first are the place of a neighbour."""
        self._biases = mlp.biases
        # (in, out) each.
        self._weights = [np.ascontiguousarray(weight.T) for weight in mlp.weights]

    def pooled(self, inputs: Array, centroids: Array) -> Array | None:
        """The maximum over the neighbours for each centroid.

        Args:
            inputs: (K, G + 3) float32, features and place of each neighbour, metres. centroids: (C, 3) float32, metres.

        Returns:
            (C, O) float32; None where so many units change that the plain form should be asked.
        """
        first, second, third = self._weights
        middle = centroids.mean(axis=0)
        slopes = first[-3:]
        rows = np.empty((len(inputs), AFFINE_ROWS, first.shape[1]), np.float32)
        rows[:, 0] = inputs @ first + (self._biases[0] - middle @ slopes)
        rows[:, 1:] = -slopes
        basis = np.empty((len(inputs), AFFINE_ROWS, len(centroids)), np.float32)
        basis[:, 0] = 1.0
        basis[:, 1:] = (centroids - middle).T
        begin = np.arange(0, AFFINE_ROWS * len(inputs) + 1, AFFINE_ROWS)

        rows, basis, begin = behind_relu(rows.reshape(-1, rows.shape[2]), basis.reshape(-1, len(centroids)), begin)
        if len(rows) > MOST_ROWS * len(inputs):
            return None
        rows = rows @ second
        rows[begin[:-1]] += self._biases[1]
        rows, basis, begin = behind_relu(rows, basis, begin)
        if len(rows) > MOST_ROWS * len(inputs):
            return None
        return largest(rows @ third, basis, begin) + self._biases[2]
