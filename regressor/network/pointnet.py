"""PointNet (Qi et al. 2017) for one number: the baseline without any grouping, and without the height above the belt.

A shared MLP of 64-64-64-128-1024 over each point (Linear, BatchNorm, ReLU), the maximum over the cloud's points, and
the head 512-256-1. The vanilla form: no input or feature transform. The head is PointRAFT's own (dropout, no batch
norm), so that two trainings with one recipe differ in how they describe a cloud and in nothing else.
"""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn

from regressor.network.pointraft import DROPOUT, SharedMlp
from regressor.network.reduced import normed

WIDTHS = (3, 64, 64, 64, 128, 1024)
HEAD = (1024, 512, 256, 1)


class PointNet(nn.Module):
    """Points to one number."""

    def __init__(self, *, dropout: float = DROPOUT) -> None:
        super().__init__()
        self.lins = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(WIDTHS))
        self.norms = nn.ModuleList(nn.BatchNorm1d(width) for width in WIDTHS[1:])
        self.regression_head = SharedMlp(HEAD, norm=False, dropout=dropout)

    def forward(self, points: Tensor, *, compute: torch.dtype | None = None) -> Tensor:
        """(B,) grams of (B, N, 3) centred clouds, metres; `compute`: dtype of the wide products, None for float32."""
        x = points.flatten(0, 1)
        for index, (lin, norm) in enumerate(zip(self.lins, self.norms, strict=True)):
            assert isinstance(lin, nn.Linear)
            assert isinstance(norm, nn.BatchNorm1d)
            # Coordinates keep their digits: only the layers behind the first are computed in fewer.
            x = torch.relu(x).to(compute or x.dtype) if index else x
            x = normed(x @ lin.weight.T.to(x.dtype), lin.bias, norm)
        # ReLU never falls, so the maximum may come first: 32 instead of 32,768 rows of 1024.
        described = torch.relu(x.reshape(*points.shape[:2], -1).amax(1)).to(points.dtype)
        out: Tensor = self.regression_head(described)
        return out[:, 0]
