"""The widest part of a training step, by blocks that stay in the processor's cache.

A set abstraction forms an edge of every centroid and each of its neighbours, runs it through two linear layers with a
batch norm between them and keeps the largest value of each channel: 8192 edges of 256 channels for one cloud. As
tensor operations that is a dozen passes over hundreds of megabytes a step. Here the edges of a few centroids at a time
are formed, used and forgotten, and two things save most of the rest:

* Only the edge that holds a channel's largest value passes a gradient on. So the way back through the last layer is
  one row for each channel of a centroid, and no product over all edges.
* The batch norm does spread a gradient over all edges, but by three numbers a channel: its part is one product with a
  small matrix, formed once.

The same numbers as `regressor.network.reduced` has without it, to rounding; of equal largest values the first edge
takes the gradient, where torch shares it out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from regressor.network.edge_loops import activate, add_moments, gather_edges, largest, pass_back, spread_back
from regressor.network.edges import edge_differences

CENTROIDS = 16
"""Of a block: with 64 neighbours, 1024 edges, whose widest array is a megabyte."""

SHAPES = 128
"""Rows of a product whose number varies are filled up to a multiple of this."""


@dataclass(frozen=True, slots=True)
class Statistics:
    """What batch norm divides by: (H,) float32 `mean` and `variance`, and `rows` they are of; 0 rows are fixed ones."""

    mean: Tensor
    variance: Tensor
    rows: int


def edge_maximum(
    source: Tensor,
    centroid: Tensor,
    weights: tuple[Tensor, Tensor],
    norm: tuple[Tensor, Tensor],
    *,
    fixed: Statistics | None,
    eps: float,
    compute: torch.dtype,
) -> tuple[Tensor, Statistics]:
    """max over k of W3 relu(norm(W2 relu(source_k - centroid_c))), and the statistics of the norm.

    Args:
        source: (B, K, W) float32. centroid: (B, C, W) float32. K is at most 256.
        weights: W2 (H, W) and W3 (O, H). norm: its scale and shift, (H,) each.
        fixed: statistics to divide by; None takes those of these edges, as in a training step, and passes gradients
            through them. The variance is the biased one.
        compute: dtype of the wide products: float32 or bfloat16.

    Returns:
        (B, C, O) float32, differentiable in all of `source`, `centroid`, `weights` and `norm`.
    """
    held: list[Statistics] = []
    out: Tensor = _EdgeMaximum.apply(source, centroid, *weights, *norm, fixed, eps, compute, held)  # type: ignore[no-untyped-call]
    return out, held[0]


class _Saved(NamedTuple):
    """What the way back needs: inputs as of `edge_maximum`, the norm's `scale` and `shift` with its statistics, what
    went into it (`hidden`, (B, C * K, H)) and which neighbour holds each maximum (`winner`, (B, C, O) uint8).
    """

    source: Tensor
    centroid: Tensor
    w2: Tensor
    w3: Tensor
    scale: Tensor
    shift: Tensor
    mean: Tensor
    variance: Tensor
    hidden: Tensor
    winner: Tensor


class _EdgeMaximum(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *args: Any) -> Tensor:
        source, centroid, w2, w3, gamma, beta, fixed, eps, compute, held = args
        batch, neighbours, _ = source.shape
        pairs = centroid.shape[1] * neighbours
        hidden = torch.empty(batch, pairs, len(w2), dtype=compute)
        sums = np.zeros((2, len(w2)))
        second = w2.T.to(compute)
        kept = _Kept(compute)
        for b, block in _blocks(source, centroid):
            edges = kept.narrow("edges", kept.edges(source[b], centroid[b, block]))
            rows = slice(block.start * neighbours, block.stop * neighbours)
            torch.mm(edges, second, out=hidden[b, rows])
            if fixed is None:
                add_moments(kept.wide("hidden", hidden[b, rows]).numpy(), sums)
        if fixed is None:
            mean, square = torch.from_numpy(sums / (batch * pairs))
            fixed = Statistics(mean.float(), (square - mean.square()).clamp_min(0.0).float(), batch * pairs)
        held.append(fixed)
        scale = gamma * torch.rsqrt(fixed.variance + eps)
        shift = beta - fixed.mean * scale
        third = w3.T.to(compute)
        out = torch.empty(batch, centroid.shape[1], len(w3))
        winner = torch.empty(out.shape, dtype=torch.uint8)
        for b, block in _blocks(source, centroid):
            rows = slice(block.start * neighbours, block.stop * neighbours)
            awake = kept.array("awake", hidden[b, rows].shape)
            activate(kept.wide("hidden", hidden[b, rows]).numpy(), scale.numpy(), shift.numpy(), awake.numpy())
            values = kept.product("values", kept.narrow("edges", awake), third)
            largest(kept.wide("largest", values).numpy(), out[b, block].numpy(), winner[b, block].numpy())
        ctx.save_for_backward(source, centroid, w2, w3, scale, shift, fixed.mean, fixed.variance, hidden, winner)
        ctx.rows, ctx.eps, ctx.compute = fixed.rows, eps, compute
        return out

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        saved = _Saved(*ctx.saved_tensors)
        w2, scale, mean = saved.w2, saved.scale, saved.mean
        passed = _passed_back(saved, gradients[0].contiguous(), ctx.compute)
        sd = torch.sqrt(saved.variance + ctx.eps)
        gamma_gradient = (passed.by_input - mean * passed.total) / sd
        constant = slope = torch.zeros_like(mean)
        if ctx.rows:
            constant, slope = passed.total / ctx.rows, gamma_gradient / (ctx.rows * sd)
        # What goes into the norm has the gradient scale * (passed - constant - slope * (input - mean)).
        spread = (w2.T * (scale * slope)).T.to(ctx.compute)
        level = (scale * (constant - slope * mean)) @ w2
        out = _spread_over_edges(saved, passed, spread, level, by_batch=ctx.rows > 0)
        common = slope[:, None] * (out.by_input - mean[:, None] * out.edge_sum)
        w2_gradient = scale[:, None] * (passed.by_edge - constant[:, None] * out.edge_sum - common)
        return (out.source, out.centroid, w2_gradient, passed.w3, gamma_gradient, passed.total, None, None, None, None)


@dataclass(frozen=True, slots=True)
class _Passed:
    """What the edges that hold a maximum pass back to the norm.

    Attributes:
        rows: of each block, (C * K,) int32 row of each edge in its gradients, -1 without one, and those, (n, H).
        total, by_input: (H,) sums of the gradients, and of them times what goes into the norm; by_edge: (H, W), times
            the edge. w3: (O, H), the last layer's gradient.
    """

    rows: list[tuple[Tensor, Tensor]]
    total: Tensor
    by_input: Tensor
    by_edge: Tensor
    w3: Tensor


@dataclass(frozen=True, slots=True)
class _Spread:
    """Gradients of `source` and `centroid`; sums over all edges: (W,), and (H, W) times what goes into the norm."""

    source: Tensor
    centroid: Tensor
    edge_sum: Tensor
    by_input: Tensor


def _passed_back(saved: _Saved, gradient: Tensor, compute: torch.dtype) -> _Passed:
    source, centroid, w2, w3 = saved.source, saved.centroid, saved.w2, saved.w3
    neighbours, kept = source.shape[1], _Kept(compute)
    affine, sums = np.stack([saved.scale.numpy(), saved.shift.numpy()]), np.zeros((2, len(w2)))
    w3_gradient, by_edge, rows = torch.zeros_like(w3), torch.zeros_like(w2), []
    for b, block in _blocks(source, centroid):
        inputs = saved.hidden[b, block.start * neighbours : block.stop * neighbours]
        passed = kept.array("passed", inputs.shape)
        row_of = torch.full((len(inputs),), -1, dtype=torch.int32)
        count = pass_back(
            gradient[b, block].numpy(),
            saved.winner[b, block].numpy(),
            kept.wide("hidden", inputs).numpy(),
            affine,
            w3.detach().numpy(),
            row_of.numpy(),
            passed.numpy(),
            w3_gradient.numpy(),
            sums,
        )
        # Few different shapes of a product: each is compiled once.
        padded = min(len(inputs), -(-count // SHAPES) * SHAPES)
        passed[count:padded] = 0.0
        edges = kept.array("edges", (padded, w2.shape[1])).zero_()
        gather_edges(source[b].numpy(), centroid[b, block].numpy(), row_of.numpy(), edges.numpy())
        by_edge += kept.narrow("passed", passed[:padded]).T @ kept.narrow("edges", edges)
        rows.append((row_of, passed[:padded].clone()))
    total, by_input = torch.from_numpy(sums).float()
    return _Passed(rows, total, by_input, by_edge, w3_gradient)


def _spread_over_edges(saved: _Saved, passed: _Passed, spread: Tensor, level: Tensor, *, by_batch: bool) -> _Spread:
    source, centroid, w2 = saved.source, saved.centroid, saved.w2
    neighbours, kept = source.shape[1], _Kept(spread.dtype)
    direct = (w2.T * saved.scale).T.to(spread.dtype)
    source_gradient, centroid_gradient = torch.zeros_like(source), torch.zeros_like(centroid)
    edge_sum, by_input = np.zeros(w2.shape[1]), torch.zeros_like(w2)
    for (b, block), (row_of, gradients) in zip(_blocks(source, centroid), passed.rows, strict=True):
        inputs = saved.hidden[b, block.start * neighbours : block.stop * neighbours]
        if by_batch:
            by_input += inputs.T @ kept.narrow("edges", kept.edges(source[b], centroid[b, block]))
            common = kept.wide("common", kept.product("spread", inputs, spread))
        else:
            common = kept.array("common", (len(inputs), w2.shape[1])).zero_()
        spread_back(
            (source[b].numpy(), centroid[b, block].numpy()),
            kept.wide("direct", kept.product("direct", kept.narrow("passed", gradients), direct)).numpy(),
            row_of.numpy(),
            common.numpy(),
            level.numpy(),
            (source_gradient[b].numpy(), centroid_gradient[b, block].numpy()),
            edge_sum,
        )
    return _Spread(source_gradient, centroid_gradient, torch.from_numpy(edge_sum).float(), by_input)


def _blocks(source: Tensor, centroid: Tensor) -> list[tuple[int, slice]]:
    count = centroid.shape[1]
    return [(b, slice(i, min(i + CENTROIDS, count))) for b in range(len(source)) for i in range(0, count, CENTROIDS)]


class _Kept:
    """Arrays of a block, kept from block to block: fresh memory costs more than what is done with it."""

    def __init__(self, compute: torch.dtype) -> None:
        self.compute = compute
        self._arrays: dict[tuple[str, torch.dtype], Tensor] = {}

    def array(self, name: str, shape: Sequence[int], dtype: torch.dtype = torch.float32) -> Tensor:
        """An array of that shape; what was in it is lost."""
        size = math.prod(shape)
        held = self._arrays.get((name, dtype))
        if held is None or held.numel() < size:
            held = self._arrays[name, dtype] = torch.empty(size, dtype=dtype)
        return held[:size].view(*shape)

    def narrow(self, name: str, values: Tensor) -> Tensor:
        """Float32 values in the dtype of the products."""
        return values if values.dtype is self.compute else self.array(name, values.shape, self.compute).copy_(values)

    def wide(self, name: str, values: Tensor) -> Tensor:
        """Values of a product in float32."""
        return values if values.dtype is torch.float32 else self.array(name, values.shape).copy_(values)

    def product(self, name: str, a: Tensor, b: Tensor) -> Tensor:
        """a @ b."""
        return torch.mm(a, b, out=self.array(name, (len(a), b.shape[1]), self.compute))

    def edges(self, source: Tensor, centroid: Tensor) -> Tensor:
        """(C * K, W) float32 edges of (K, W) `source` and (C, W) `centroid`."""
        out = self.array("edges", (len(source) * len(centroid), source.shape[1]))
        edge_differences(source.numpy(), centroid.numpy(), out.numpy())
        return out
