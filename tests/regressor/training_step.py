"""A training step of the readable network in float64, and of another form of it: they must be the same step."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from regressor.network.pointraft import PointRaft


def readable_in_training() -> PointRaft:
    """A fresh network in float64 that drops nothing out."""
    torch.manual_seed(0)
    readable = PointRaft(dropout=0.0).double().train()
    for module in readable.modules():
        if isinstance(module, torch.nn.BatchNorm1d):
            # A fresh bias of 0 puts every point's edge to itself exactly on the kink of the ReLU.
            torch.nn.init.normal_(module.bias, std=0.3)
    return readable


def check_same_step(readable: PointRaft, expected: Tensor, other: PointRaft, found: Tensor) -> None:
    """Assert that both (n,) answers, their gradients and the statistics of batch norm are the same."""
    assert found.detach().numpy() == pytest.approx(expected.detach().numpy(), rel=1e-10)
    expected.square().sum().backward()  # type: ignore[no-untyped-call]
    found.square().sum().backward()  # type: ignore[no-untyped-call]
    for (name, a), (_, b) in zip(readable.named_parameters(), other.named_parameters(), strict=True):
        if b.grad is None:
            assert float(a.grad.norm()) < 1e-9, name  # a bias that batch norm cancels
        else:
            assert torch.allclose(a.grad, b.grad, rtol=1e-7, atol=1e-9), name
    for (name, before), (_, after) in zip(readable.named_buffers(), other.named_buffers(), strict=True):
        assert torch.allclose(before.double(), after.double(), rtol=1e-9), name
