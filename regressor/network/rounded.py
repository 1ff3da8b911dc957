"""The wide products of the fast form from operands rounded to bfloat16, by oneDNN through torch.

NumPy has no such type: bits are handed over in uint16. oneDNN fuses bias and ReLU. Where it does not multiply bfloat16
on this processor, torch's own products give the same to rounding and take some thirty times as long (measured on an
AVX2 processor: 2.6 against 69 GFLOP/s in float32). The choice depends on the build and the processor only, never on a
timing: the same machine always gives the same bits.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import torch
from torch import Tensor

from regressor.network.architecture import NEIGHBOURS
from regressor.network.edges import edge_differences_bfloat16, live_units, pooled_maximum_bfloat16
from regressor.network.products import BLOCK_CENTROIDS, LIVE_STEP, Array, Folded, Room, differences

Layer = Callable[[Tensor, Tensor, Tensor | None, bool], Tensor]


class RoundedProducts:
    """Products of bfloat16 operands, summed in float32."""

    def __init__(self, stages: list[Folded]) -> None:
        layer = fused_layer() if onednn_multiplies_bfloat16() else None
        self._layer = layer or _torch_layer
        self._weights = [tuple(torch.from_numpy(w).bfloat16() for w in stage.weights) for stage in stages]
        self._biases = [tuple(torch.from_numpy(b).bfloat16() for b in stage.biases) for stage in stages]
        # (I, O) each, as bits: of these the rows of live units are picked.
        self._last_two = [weight.T.contiguous().view(torch.int16).numpy() for weight in self._weights[2][1:]]
        if layer is not None:
            rows = BLOCK_CENTROIDS * NEIGHBOURS
            for stage in (0, 1):
                first, *others = self._weights[stage]
                self._weights[stage] = (first, *(packed_weight(weight, rows) for weight in others))
        self._room = Room(np.uint16)

    def abstract(self, stage: int, sources: list[Array], centroids: Array, out: Array) -> None:
        """As `Wide` says."""
        edges = self._room.of(stage, 0, len(centroids) * NEIGHBOURS, centroids.shape[1])
        differences(sources, centroids, edges, edge_differences_bfloat16)
        weights, biases = self._weights[stage], self._biases[stage]
        with torch.inference_mode():
            hidden = self._layer(torch.from_numpy(edges).view(torch.bfloat16), weights[1], biases[1], True)
            values = self._layer(hidden, weights[2], None, False)
            pooled_maximum_bfloat16(values.view(torch.int16).numpy(), out)

    def describe(self, rows: Array) -> Array:
        """As `Wide` says."""
        weights, biases = self._weights[2], self._biases[2]
        with torch.inference_mode():
            x = self._layer(torch.from_numpy(rows).bfloat16(), weights[0], biases[0], True)
            x = self._layer(*self._live(x, 0), biases[1], True)
            described: Array = self._layer(*self._live(x, 1), None, False).amax(0).float().numpy()
        return described

    def _live(self, x: Tensor, layer: int) -> tuple[Tensor, Tensor]:
        """(rows, L) live columns of activations and the (O, L) weights that they meet in one of the last two layers."""
        columns, rows = live_units(x.view(torch.int16).numpy(), self._last_two[layer], LIVE_STEP)
        return torch.from_numpy(columns).view(torch.bfloat16), torch.from_numpy(rows).view(torch.bfloat16).T


def fused_layer() -> Layer | None:
    """oneDNN's linear layer (with ReLU, where asked) of weights in its own order; None where this build lacks it."""
    mkldnn = torch.ops.mkldnn
    if not torch.backends.mkldnn.is_available() or not hasattr(mkldnn, "_reorder_linear_weight"):  # type: ignore[no-untyped-call]
        return None
    fused = getattr(mkldnn, "_linear_pointwise", None)
    if fused is None:
        return None

    def layer(x: Tensor, weight: Tensor, bias: Tensor | None, relu: bool) -> Tensor:
        out: Tensor = fused(x, weight, bias, "relu" if relu else "none", [], "")
        return out

    return layer


def packed_weight(weight: Tensor, rows: int) -> Tensor:
    """An (out, in) weight in oneDNN's own order: the same sums, without ordering it again for each block of `rows`."""
    with torch.inference_mode():
        ordered: Tensor = torch.ops.mkldnn._reorder_linear_weight(weight, rows)
    return ordered


@cache
def onednn_multiplies_bfloat16() -> bool:
    """Whether this build of torch has oneDNN, and that takes a product of bfloat16 on this processor."""
    layer = fused_layer()
    if layer is None:
        return False
    ones = torch.ones(32, 32, dtype=torch.bfloat16)
    try:
        with torch.inference_mode():
            layer(ones, packed_weight(ones, 32), None, False)
    except RuntimeError:
        return False
    return True


def _torch_layer(x: Tensor, weight: Tensor, bias: Tensor | None, relu: bool) -> Tensor:
    out = torch.nn.functional.linear(x, weight, bias)
    return out.relu_() if relu else out
