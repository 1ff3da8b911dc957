"""The networks that one recipe trains: PointRAFT and the baseline PointNet, behind one way to make and to run them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, TypeAlias

import torch
from torch import Tensor

from regressor.network.grouped import gathered_forward
from regressor.network.grouping import GatheredGroups
from regressor.network.pointnet import PointNet
from regressor.network.pointraft import PointRaft
from regressor.network.reduced import FULL, Resolution, reduced_forward

Network: TypeAlias = PointRaft | PointNet
Kind = Literal["pointraft", "pointnet"]

POINTNET_POINTS = 1024
"""PointNet has no neighbourhoods to sample for: it is given all of a cloud's points."""


def new_network(kind: Kind, *, height_embedding: bool, dropout: float) -> Network:
    """A network with fresh parameters."""
    if kind == "pointnet":
        return PointNet(dropout=dropout)
    return PointRaft(height_embedding=height_embedding, dropout=dropout)


def run_network(
    model: Network,
    points: Tensor,
    heights_m: Tensor,
    *,
    resolution: Resolution = FULL,
    compute: torch.dtype | None = None,
    groups: Sequence[GatheredGroups] | None = None,
) -> Tensor:
    """(B,) grams of (B, N, 3) clouds, centred, metres, in sampling order, and (B,) clamped heights.

    PointRAFT reads the points that `resolution` names, or the clouds' `groups` where a radius binds in one of them;
    PointNet reads all points and no height.
    """
    if isinstance(model, PointNet):
        return model(points, compute=compute)  # type: ignore[no-any-return]
    if groups is not None:
        return gathered_forward(model, groups, heights_m, centroids=resolution.centroids, compute=compute)
    return reduced_forward(model, points, heights_m, resolution=resolution, compute=compute)
