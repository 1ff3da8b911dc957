"""The fast exact form of PointRAFT for one cloud at a time on the CPU.

Against the readable form: batch norm is folded into the weights, first layers are computed per point instead of per
edge, only the centroids that are read are computed, and the edges pass through in blocks of 32 centroids that stay in
the second-level cache. Clouds do not meet in a product, so a weight does not depend on the batch it came with; on a
CPU nothing is lost by that, the products of one cloud are large enough.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from regressor.grouping import GatheredGroups, SharedGroups
from regressor.pointraft import NEIGHBOURS, PointRaft, SharedMlp

BLOCK_CENTROIDS = 32

Layer = Callable[[Tensor, Tensor, Tensor | None, bool], Tensor]


@dataclass(frozen=True, slots=True)
class _Folded:
    """Weights (out, in) and biases of a shared MLP with its batch norms folded in."""

    weights: tuple[Tensor, ...]
    biases: tuple[Tensor, ...]


class FastPointRaft:
    """Grams from groups. Not thread-safe: one instance per worker."""

    def __init__(self, model: PointRaft) -> None:
        self._layer = fused_layer()
        self._stage1 = _fold(model.sa1_module.conv.local_nn)
        self._stage2 = _fold(model.sa2_module.conv.local_nn)
        self._stage3 = _fold(model.sa3_module.nn)
        self._height = _fold(model.height_embed) if model.height_embed is not None else None
        self._head = _fold(model.regression_head)
        self._block = {
            width: torch.empty(BLOCK_CENTROIDS, NEIGHBOURS, width)
            for width in (self._stage1.weights[0].shape[0], self._stage2.weights[0].shape[0])
        }

    def weigh(self, groups: SharedGroups | GatheredGroups, height_m: float) -> float:
        """Grams of one cloud. `height_m`: above the belt, clamped, metres."""
        with torch.inference_mode():
            return float(self._head_of(self._describe(groups), height_m))

    def _describe(self, groups: SharedGroups | GatheredGroups) -> Tensor:
        """(1024,) global feature."""
        if isinstance(groups, SharedGroups):
            source, index1, index2 = torch.from_numpy(groups.neighbours), None, None
        else:
            source = torch.from_numpy(groups.points)
            index1, index2 = torch.from_numpy(groups.neighbours1), torch.from_numpy(groups.neighbours2)
        centroids1, centroids2 = torch.from_numpy(groups.centroids1), torch.from_numpy(groups.centroids2)
        features1 = self._abstract(self._stage1, source, centroids1, index1)
        features2 = self._abstract(self._stage2, torch.cat([features1, centroids1], dim=1), centroids2, index2)
        x = torch.cat([features2, centroids2], dim=1)
        for weight, bias in zip(self._stage3.weights[:-1], self._stage3.biases[:-1], strict=True):
            x = self._layer(x, weight, bias, True)
        return self._layer(x, self._stage3.weights[-1], None, False).amax(0) + self._stage3.biases[-1]

    def _abstract(self, mlp: _Folded, inputs: Tensor, centroids: Tensor, index: Tensor | None) -> Tensor:
        """(C, O): max over the neighbours (`inputs` (K, G + 3), or those that (C, 64) `index` picks)."""
        source = torch.addmm(mlp.biases[0], inputs, mlp.weights[0].T)
        centroid = centroids @ mlp.weights[0][:, -3:].T
        pooled = torch.empty(len(centroids), mlp.weights[2].shape[0])
        block = self._block[source.shape[1]]
        for begin in range(0, len(centroids), BLOCK_CENTROIDS):
            part = slice(begin, min(begin + BLOCK_CENTROIDS, len(centroids)))
            edges = block[: part.stop - begin]
            of_source = source[None] if index is None else source[index[part]]
            torch.sub(of_source, centroid[part, None], out=edges)
            hidden = self._layer(edges.relu_().flatten(0, 1), mlp.weights[1], mlp.biases[1], True)
            values = self._layer(hidden, mlp.weights[2], None, False)
            torch.amax(values.view(len(edges), NEIGHBOURS, -1), dim=1, out=pooled[part])
        return pooled.add_(mlp.biases[2])

    def _head_of(self, described: Tensor, height_m: float) -> Tensor:
        x = described[None]
        if self._height is not None:
            x = torch.cat([x, _plain(self._height, torch.tensor([[height_m]], dtype=torch.float32))], dim=1)
        return _plain(self._head, x)[0, 0]


def _plain(mlp: _Folded, x: Tensor) -> Tensor:
    for weight, bias in zip(mlp.weights[:-1], mlp.biases[:-1], strict=True):
        x = torch.relu(torch.nn.functional.linear(x, weight, bias))
    return torch.nn.functional.linear(x, mlp.weights[-1], mlp.biases[-1])


def _fold(mlp: SharedMlp) -> _Folded:
    """Each batch norm folded into the linear layer before it, in float64."""
    weights, biases = [], []
    for index in range(len(mlp.lins)):
        weight, bias = mlp.linear(index).weight.double(), mlp.linear(index).bias.double()
        if index < len(mlp.norms) and mlp.normed:
            norm = mlp.norm(index)
            if norm.running_mean is None or norm.running_var is None:
                raise ValueError("batch norm without running statistics cannot be folded")
            scale = norm.weight.double() / torch.sqrt(norm.running_var.double() + norm.eps)
            weight = weight * scale[:, None]
            bias = (bias - norm.running_mean.double()) * scale + norm.bias.double()
        weights.append(weight.detach().float().contiguous())
        biases.append(bias.detach().float().contiguous())
    return _Folded(tuple(weights), tuple(biases))


def fused_layer() -> Layer:
    """linear (with ReLU, where asked) by oneDNN where this build of torch has it, else by torch's own product.

    oneDNN fuses bias and ReLU and reaches twice the rate of the default product on processors that MKL does not know
    (measured on a Zen 5: 210 against 95 GFLOP/s, float32, one core). The choice depends on the build only, never on a
    timing: the same machine always gives the same bits.
    """
    fused = getattr(torch.ops.mkldnn, "_linear_pointwise", None) if torch.backends.mkldnn.is_available() else None  # type: ignore[no-untyped-call]
    if fused is None:
        return _torch_layer

    def layer(x: Tensor, weight: Tensor, bias: Tensor | None, relu: bool) -> Tensor:
        out: Tensor = fused(x, weight, bias, "relu" if relu else "none", [], "")
        return out

    return layer


def _torch_layer(x: Tensor, weight: Tensor, bias: Tensor | None, relu: bool) -> Tensor:
    out = torch.nn.functional.linear(x, weight, bias)
    return out.relu_() if relu else out


def groups_tensor(groups: SharedGroups) -> NDArray[np.float32]:
    """(256, 3) float32: the three lists end to end, the fixed shape an exported network takes."""
    return np.concatenate([groups.neighbours, groups.centroids1, groups.centroids2])
