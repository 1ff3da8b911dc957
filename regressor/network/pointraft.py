"""PointRAFT as in the paper (Blok et al., single-view potato weight from a point cloud), in plain PyTorch.

This is the readable form: it is used for conformance tests, for import and export, and as the reference of the fast
form in `regressor.network.fast`. The parameters bear the names of the authors' checkpoint, so its state dict loads as
it is.

Rules the paper does not state, taken from the authors' code (pieterblok/pointraft, commit 593bc7c):
every layer but the last of a shared MLP is Linear, BatchNorm, ReLU; the last is Linear alone, so the max-pools run
over values that may be negative. A message is [features of the neighbour, position of the neighbour - position of
the centroid], in this order. Only the global stage sees absolute (centred) positions. Dropout acts in the head only.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor, nn

from regressor.network.architecture import (
    HEIGHT,
    NEIGHBOURS,
    RADIUS_1_M,
    RADIUS_2_M,
    RATIO_1,
    RATIO_2,
    STAGE_1,
    STAGE_2,
    STAGE_3,
    head_widths,
)
from regressor.network.sampling import farthest_points, first_in_range

DROPOUT = 0.5


class _Norm(nn.Module):
    """Batch norm under the name PyTorch Geometric gives it (`norms.<i>.module`)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.module = nn.BatchNorm1d(width)

    def forward(self, x: Tensor) -> Tensor:
        out: Tensor = self.module(x)
        return out


class SharedMlp(nn.Module):
    """Linear, BatchNorm, ReLU, Dropout for every layer but the last; the last is Linear alone."""

    def __init__(self, widths: Sequence[int], *, norm: bool = True, dropout: float = 0.0) -> None:
        super().__init__()
        self.lins = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(widths))
        self.norms = nn.ModuleList(_Norm(width) if norm else nn.Identity() for width in widths[1:-1])
        self.normed = norm
        self.dropout = dropout

    def linear(self, index: int) -> nn.Linear:
        """Linear layer `index`."""
        layer = self.lins[index]
        assert isinstance(layer, nn.Linear)
        return layer

    def norm(self, index: int) -> nn.BatchNorm1d:
        """Batch norm after linear layer `index`."""
        wrapper = self.norms[index]
        assert isinstance(wrapper, _Norm)
        return wrapper.module

    def forward(self, x: Tensor) -> Tensor:
        for lin, norm in zip(self.lins, self.norms, strict=False):
            x = torch.relu(norm(lin(x)))
            if self.dropout:
                x = nn.functional.dropout(x, self.dropout, self.training)
        out: Tensor = self.lins[-1](x)
        return out


class _PointConv(nn.Module):
    """Max over the messages of a centroid's neighbours."""

    def __init__(self, widths: Sequence[int]) -> None:
        super().__init__()
        self.local_nn = SharedMlp(widths)

    def forward(self, features: Tensor | None, offsets: Tensor, edges: Tensor, centroids: int) -> Tensor:
        source, target = edges
        messages = offsets if features is None else torch.cat([features[source], offsets], dim=1)
        values = self.local_nn(messages)
        index = target[:, None].expand_as(values)
        empty = values.new_zeros(centroids, values.shape[1])
        pooled: Tensor = empty.scatter_reduce(0, index, values, "amax", include_self=False)
        return pooled


class SetAbstraction(nn.Module):
    """Sample centroids, group the points around each of them, describe each group."""

    def __init__(self, ratio: float, radius_m: float, widths: Sequence[int]) -> None:
        super().__init__()
        self.ratio = ratio
        self.radius_m = radius_m
        self.sample = farthest_points
        self.conv = _PointConv(widths)

    def forward(self, features: Tensor | None, clouds: list[Tensor]) -> tuple[Tensor, list[Tensor]]:
        """(features of the centroids of all clouds, centroids of each cloud); clouds are (N, 3), metres."""
        centroids, edges, offsets = [], [], []
        first_point = first_centroid = 0
        for cloud in clouds:
            points = cloud.detach().to(torch.float32).cpu().numpy()
            picked = self.sample(points, int(np.ceil(np.float32(len(points)) * np.float32(self.ratio))))
            found = torch.from_numpy(first_in_range(points, points[picked], self.radius_m, NEIGHBOURS))
            target, slot = torch.nonzero(found >= 0, as_tuple=True)
            source = found[target, slot]
            centroid = cloud[torch.from_numpy(picked)]
            offsets.append(cloud[source] - centroid[target])
            edges.append(torch.stack([source + first_point, target + first_centroid]).to(cloud.device))
            centroids.append(centroid)
            first_point += len(cloud)
            first_centroid += len(centroid)
        return self.conv(features, torch.cat(offsets), torch.cat(edges, dim=1), first_centroid), centroids


class GlobalAbstraction(nn.Module):
    """One vector per cloud: a shared MLP over all centroids, then the max."""

    def __init__(self, widths: Sequence[int]) -> None:
        super().__init__()
        self.nn = SharedMlp(widths)

    def forward(self, features: Tensor, clouds: list[Tensor]) -> Tensor:
        values = self.nn(torch.cat([features, torch.cat(clouds)], dim=1))
        return torch.stack([part.amax(0) for part in values.split([len(cloud) for cloud in clouds])])


class PointRaft(nn.Module):
    """Point cloud and height above the belt to grams."""

    def __init__(self, *, height_embedding: bool = True, dropout: float = DROPOUT) -> None:
        super().__init__()
        self.sa1_module = SetAbstraction(RATIO_1, RADIUS_1_M, STAGE_1)
        self.sa2_module = SetAbstraction(RATIO_2, RADIUS_2_M, STAGE_2)
        self.sa3_module = GlobalAbstraction(STAGE_3)
        self.height_embed = SharedMlp(HEIGHT) if height_embedding else None
        self.regression_head = SharedMlp(head_widths(height_embedding=height_embedding), norm=False, dropout=dropout)

    def features(self, clouds: Sequence[Tensor]) -> tuple[Tensor, Tensor, Tensor]:
        """Features after each stage: (sum n1, 128), (sum n2, 256), (B, 1024)."""
        points = list(clouds)
        stage1, points1 = self.sa1_module(None, points)
        stage2, points2 = self.sa2_module(stage1, points1)
        return stage1, stage2, self.sa3_module(stage2, points2)

    def forward(self, clouds: Sequence[Tensor], heights_m: Tensor) -> Tensor:
        """Weights of B clouds.

        Args:
            clouds: B tensors (N, 3), metres, camera or level frame, centred, in sampling order; at most 1024 points
                each. One cloud must have at least one point.
            heights_m: (B,) height above the belt, metres, clamped to 0..0.08.

        Returns:
            (B,) grams.
        """
        described = self.features(clouds)[2]
        if self.height_embed is not None:
            described = torch.cat([described, self.height_embed(heights_m[:, None])], dim=1)
        out: Tensor = self.regression_head(described)
        return out[:, 0]
