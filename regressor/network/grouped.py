"""PointRAFT on groups of many clouds at once, with gradients, on any device: for trainings and for fits over thousands.

`regressor.network.reduced` takes clouds that are smaller than both radii. Here each cloud comes with the groups that it
is weighed by: the shared lists, or the general form where a radius binds.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from regressor.network.grouping import GatheredGroups, SharedGroups
from regressor.network.pointraft import PointRaft, SharedMlp
from regressor.network.reduced import FULL, Resolution, grams_of, normed, shared_forward

Groups = SharedGroups | GatheredGroups


def grouped_forward(
    model: PointRaft,
    groups: Sequence[Groups],
    heights_m: Tensor,
    *,
    resolution: Resolution = FULL,
    compute: torch.dtype | None = None,
) -> Tensor:
    """(B,) grams of B clouds, each by its own form, from a model in eval mode.

    Args:
        heights_m: (B,) clamped, metres, on the model's device.
        resolution: centroids of the shared form; the general one has all of them, as in `regressor.network.fast`.
        compute: dtype of the wide products; None is the model's own.
    """
    weight_g = heights_m.new_empty(len(groups))
    shared = [(row, group) for row, group in enumerate(groups) if isinstance(group, SharedGroups)]
    gathered = [(row, group) for row, group in enumerate(groups) if isinstance(group, GatheredGroups)]
    if shared:
        rows = [row for row, _ in shared]
        neighbours, centroids1, centroids2 = (
            _stacked([getattr(group, name) for _, group in shared], heights_m.device)
            for name in ("neighbours", "centroids1", "centroids2")
        )
        weight_g[rows] = shared_forward(
            model, neighbours, centroids1, centroids2, heights_m[rows], resolution=resolution, compute=compute
        )
    if gathered:
        rows = [row for row, _ in gathered]
        weight_g[rows] = gathered_forward(model, [group for _, group in gathered], heights_m[rows], compute=compute)
    return weight_g


def gathered_forward(
    model: PointRaft,
    groups: Sequence[GatheredGroups],
    heights_m: Tensor,
    *,
    centroids: int | None = None,
    compute: torch.dtype | None = None,
) -> Tensor:
    """(B,) grams of B clouds in the general form; in train mode batch norm sees the edges of all of them.

    Args:
        heights_m: (B,) clamped, metres, on the model's device.
        centroids: second-stage centroids that are used, at most; None is all.
        compute: dtype of the wide products; None is the model's own.
    """
    device = heights_m.device
    points, centroids1, neighbours1 = (
        _stacked([getattr(group, name) for group in groups], device) for name in ("points", "centroids1", "neighbours1")
    )
    centroids2, neighbours2 = (
        _stacked([getattr(group, name)[:centroids] for group in groups], device)
        for name in ("centroids2", "neighbours2")
    )
    stage1 = _features(model.sa1_module.conv.local_nn, points, centroids1, neighbours1, compute)
    pairs = torch.cat([stage1, centroids1], dim=2)
    stage2 = _features(model.sa2_module.conv.local_nn, pairs, centroids2, neighbours2, compute)
    return grams_of(model, torch.cat([stage2, centroids2], dim=2), heights_m, compute)


def _features(
    mlp: SharedMlp, inputs: Tensor, centroids: Tensor, neighbours: Tensor, compute: torch.dtype | None
) -> Tensor:
    """(B, C, O): max over what (B, C, 64) `neighbours` picks of (B, K, G + 3) `inputs`, for (B, C, 3) `centroids`."""
    first, second, third = mlp.linear(0), mlp.linear(1), mlp.linear(2)
    source = inputs @ first.weight.T
    row = torch.arange(len(inputs), device=inputs.device)[:, None, None]
    edges = source[row, neighbours] - (centroids @ first.weight[:, -3:].T)[:, :, None]
    dtype = compute or source.dtype
    x = torch.relu(normed(edges.flatten(0, 2), first.bias, mlp.norm(0))).to(dtype)
    x = torch.relu(normed(x @ second.weight.T.to(dtype), second.bias, mlp.norm(1)))
    values = (x @ third.weight.T.to(dtype)).reshape(*neighbours.shape, -1)
    return values.amax(2).to(third.weight.dtype) + third.bias


def _stacked(rows: Sequence[NDArray[np.float32] | NDArray[np.int64]], device: torch.device) -> Tensor:
    """(B, longest, ...): each padded by repetition, which no maximum notices."""
    longest = max(len(row) for row in rows)
    return torch.from_numpy(np.stack([row[np.resize(np.arange(len(row)), longest)] for row in rows])).to(device)
