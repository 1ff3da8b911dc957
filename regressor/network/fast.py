"""The fast exact form of PointRAFT for one cloud at a time on the CPU.

Against the readable form: batch norm is folded into the weights, first layers are computed per point instead of per
edge, only the centroids that are read are computed, and the edges pass through in blocks of 32 centroids that stay in
the second-level cache. Of the last stage only those units are carried on that some row of this cloud wakes: behind a
ReLU two in three are zero in all 128 rows, which adds nothing to a product. Clouds do not meet in a product, so a
weight does not depend on the batch it came with; on a CPU nothing is lost by that, the products of one cloud are large
enough.

Two ways to save time are not exact and have to be asked for (`Form`): products of bfloat16 operands, and fewer
second-stage centroids. What they cost in grams stands in docs/pointraft.md (`python -m benchmarks regressor`).
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from regressor.network.edges import (
    edge_differences,
    edge_differences_bfloat16,
    live_units,
    pooled_maximum,
    pooled_maximum_bfloat16,
)
from regressor.network.grouping import GatheredGroups, SharedGroups
from regressor.network.pointraft import NEIGHBOURS, PointRaft, SharedMlp

BLOCK_CENTROIDS = 32
LIVE_STEP = 32
"""See `live_units`."""

Layer = Callable[[Tensor, Tensor, Tensor | None, bool], Tensor]


@dataclass(frozen=True, slots=True)
class Form:
    """How a network is computed. The default is exact.

    Attributes:
        precision: of the operands of the wide products; sums are float32 in both.
        centroids: of the second stage that are used, at most, where all of them have the same neighbours; None is all.
    """

    precision: Literal["float32", "bfloat16"] = "float32"
    centroids: int | None = None

    @property
    def flags(self) -> tuple[str, ...]:
        """What a weight from this form is flagged with."""
        rounded = ("bfloat16",) if self.precision == "bfloat16" else ()
        return rounded if self.centroids is None else (*rounded, f"centroids_{self.centroids}")


EXACT = Form()


@dataclass(frozen=True, slots=True)
class _Folded:
    """Weights (out, in) and biases of a shared MLP with its batch norms folded in; `wide` as the products take them."""

    weights: tuple[Tensor, ...]
    biases: tuple[Tensor, ...]
    wide: tuple[Tensor, ...]
    wide_biases: tuple[Tensor, ...]


class _Blocks(threading.local):
    """Room for the edges of one block, by their width. Each thread has its own: they are written while it weighs."""

    def __init__(self, rows: int, kind: type[np.uint16] | type[np.float32]) -> None:
        self._rows, self._kind = rows, kind
        self._made: dict[int, NDArray[np.uint16] | NDArray[np.float32]] = {}

    def of_width(self, width: int) -> NDArray[np.uint16] | NDArray[np.float32]:
        """(rows, width); what stood there before is not kept."""
        if width not in self._made:
            self._made[width] = np.empty((self._rows, width), self._kind)  # type: ignore[assignment]
        return self._made[width]


class FastPointRaft:
    """Grams from groups. Several threads may weigh with one instance."""

    def __init__(self, model: PointRaft, form: Form = EXACT) -> None:
        self.form = form
        self._dtype = torch.bfloat16 if form.precision == "bfloat16" else torch.float32
        self._layer = fused_layer(self._dtype)
        rows = BLOCK_CENTROIDS * NEIGHBOURS
        self._stage1 = _packed(_fold(model.sa1_module.conv.local_nn, self._dtype), rows)
        self._stage2 = _packed(_fold(model.sa2_module.conv.local_nn, self._dtype), rows)
        self._stage3 = _fold(model.sa3_module.nn, self._dtype)
        self._bits = torch.int16 if form.precision == "bfloat16" else torch.int32
        # (I, O) each, as bits: NumPy has no bfloat16. Of these the rows of live units are picked.
        self._last_two = [weight.T.contiguous().view(self._bits).numpy() for weight in self._stage3.wide[1:]]
        self._height = _fold(model.height_embed) if model.height_embed is not None else None
        self._head = _fold(model.regression_head)
        self._blocks = _Blocks(rows, np.uint16 if self._dtype == torch.bfloat16 else np.float32)

    def weigh(self, groups: SharedGroups | GatheredGroups, height_m: float) -> float:
        """Grams of one cloud. `height_m`: above the belt, clamped, metres."""
        with torch.inference_mode():
            return float(self._head_of(self._describe(groups), height_m))

    def _describe(self, groups: SharedGroups | GatheredGroups) -> Tensor:
        """(1024,) global feature."""
        if isinstance(groups, SharedGroups):
            used = slice(self.form.centroids)
            source, index1, index2 = torch.from_numpy(groups.neighbours), None, None
        else:
            used = slice(None)  # each centroid has a part of the cloud of its own to tell of
            source, index1, index2 = torch.from_numpy(groups.points), groups.neighbours1, groups.neighbours2
        centroids1, centroids2 = torch.from_numpy(groups.centroids1), torch.from_numpy(groups.centroids2[used])
        features1 = self._abstract(self._stage1, source, centroids1, index1)
        features2 = self._abstract(self._stage2, torch.cat([features1, centroids1], dim=1), centroids2, index2)
        mlp = self._stage3
        x = self._layer(
            torch.cat([features2, centroids2], dim=1).to(self._dtype), mlp.wide[0], mlp.wide_biases[0], True
        )
        x = self._layer(*self._live(x, 0), mlp.wide_biases[1], True)
        return self._layer(*self._live(x, 1), None, False).amax(0).float() + mlp.biases[2]

    def _live(self, x: Tensor, layer: int) -> tuple[Tensor, Tensor]:
        """(rows, L) live columns of activations and the (O, L) weights that they meet in one of the last two layers."""
        columns, rows = live_units(x.view(self._bits).numpy(), self._last_two[layer], LIVE_STEP)
        return torch.from_numpy(columns).view(self._dtype), torch.from_numpy(rows).view(self._dtype).T

    def _abstract(self, mlp: _Folded, inputs: Tensor, centroids: Tensor, index: NDArray[np.int64] | None) -> Tensor:
        """(C, O): max over the neighbours (`inputs` (K, G + 3), or those that (C, 64) `index` picks)."""
        source = torch.addmm(mlp.biases[0], inputs, mlp.weights[0].T).numpy()
        centroid = (centroids @ mlp.weights[0][:, -3:].T).numpy()
        pooled = np.empty((len(centroid), mlp.weights[2].shape[0]), np.float32)
        block = self._blocks.of_width(source.shape[1])
        for begin in range(0, len(centroid), BLOCK_CENTROIDS):
            part = slice(begin, min(begin + BLOCK_CENTROIDS, len(centroid)))
            edges = block[: (part.stop - begin) * NEIGHBOURS]
            if index is None:
                self._differences(source, centroid[part], edges)
            else:
                for row in range(part.stop - begin):
                    one = slice(begin + row, begin + row + 1)
                    here = edges[row * NEIGHBOURS : (row + 1) * NEIGHBOURS]
                    self._differences(source[index[begin + row]], centroid[one], here)
            self._pool(self._products(edges, mlp), pooled[part])
        return torch.from_numpy(pooled).add_(mlp.biases[2])

    def _products(self, edges: NDArray[np.float32] | NDArray[np.uint16], mlp: _Folded) -> Tensor:
        x = torch.from_numpy(edges)
        x = x.view(torch.bfloat16) if self._dtype == torch.bfloat16 else x
        hidden = self._layer(x, mlp.wide[1], mlp.wide_biases[1], True)
        return self._layer(hidden, mlp.wide[2], None, False)

    def _differences(
        self,
        source: NDArray[np.float32],
        centroid: NDArray[np.float32],
        out: NDArray[np.float32] | NDArray[np.uint16],
    ) -> None:
        kernel: Callable[..., None] = edge_differences_bfloat16 if out.dtype == np.uint16 else edge_differences
        kernel(source, centroid, out)

    def _pool(self, values: Tensor, out: NDArray[np.float32]) -> None:
        if self._dtype == torch.bfloat16:
            pooled_maximum_bfloat16(values.view(torch.int16).numpy(), out)
        else:
            pooled_maximum(values.numpy(), out)

    def _head_of(self, described: Tensor, height_m: float) -> Tensor:
        x = described[None]
        if self._height is not None:
            x = torch.cat([x, _plain(self._height, torch.tensor([[height_m]], dtype=torch.float32))], dim=1)
        return _plain(self._head, x)[0, 0]


def _plain(mlp: _Folded, x: Tensor) -> Tensor:
    for weight, bias in zip(mlp.weights[:-1], mlp.biases[:-1], strict=True):
        x = torch.relu(torch.nn.functional.linear(x, weight, bias))
    return torch.nn.functional.linear(x, mlp.weights[-1], mlp.biases[-1])


def _fold(mlp: SharedMlp, wide: torch.dtype = torch.float32) -> _Folded:
    """Each batch norm folded into the linear layer before it, in float64; `wide`: dtype of the wide products."""
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
    rounded = (tuple(value.to(wide) for value in values) for values in (weights, biases))
    return _Folded(tuple(weights), tuple(biases), *rounded)


def _packed(mlp: _Folded, rows: int) -> _Folded:
    """The wide weights of the second and third layer as `packed_weight` has them."""
    return replace(mlp, wide=(mlp.wide[0], *(packed_weight(weight, rows) for weight in mlp.wide[1:])))


def packed_weight(weight: Tensor, rows: int) -> Tensor:
    """An (out, in) weight in oneDNN's own order, where `fused_layer` uses that: the same sums, without ordering the
    weight again for each block of `rows`.
    """
    if _onednn(weight.dtype) is None:
        return weight
    with torch.inference_mode():
        ordered: Tensor = torch.ops.mkldnn._reorder_linear_weight(weight, rows)
    return ordered


@cache
def multiplies_bfloat16() -> bool:
    """Whether oneDNN multiplies bfloat16 on this processor; an x86 one needs AVX-512 or AVX-NE-CONVERT for it.

    Where it does not, torch's own products give the same to rounding and take some thirty times as long (measured on an
    AVX2 processor: 2.6 against 69 GFLOP/s in float32). oneDNN is asked for a product: it may be told to use less than
    the processor has (`ONEDNN_MAX_CPU_ISA`), which no list of instructions shows.
    """
    layer = _onednn(torch.float32)
    if layer is None:
        return False
    ones = torch.ones(32, 32, dtype=torch.bfloat16)
    try:
        with torch.inference_mode():
            layer(ones, torch.ops.mkldnn._reorder_linear_weight(ones, 32), None, "none", [], "")
    except RuntimeError:
        return False
    return True


def _onednn(dtype: torch.dtype) -> Callable[..., Tensor] | None:
    """oneDNN's linear layer, and with it its order of weights, where this build of torch has both and this processor
    multiplies `dtype`.
    """
    if not torch.backends.mkldnn.is_available() or not hasattr(torch.ops.mkldnn, "_reorder_linear_weight"):  # type: ignore[no-untyped-call]
        return None
    if dtype == torch.bfloat16 and not multiplies_bfloat16():
        return None
    return getattr(torch.ops.mkldnn, "_linear_pointwise", None)


def fused_layer(dtype: torch.dtype = torch.float32) -> Layer:
    """linear (with ReLU, where asked) by oneDNN where this build of torch has it, else by torch's own product.

    oneDNN fuses bias and ReLU and reaches twice the rate of the default product on processors that MKL does not know
    (measured on a Zen 5: 210 against 95 GFLOP/s, float32, one core). The choice depends on the build and the processor
    only, never on a timing: the same machine always gives the same bits.

    Args:
        dtype: of the operands, float32 or bfloat16.
    """
    fused = _onednn(dtype)
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
