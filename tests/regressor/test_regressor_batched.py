"""Many clouds at once give what each gives alone, on every device that is here."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from conveyor.errors import InputError
from regressor.network.batched import BatchedPointRaft
from regressor.network.checkpoint import load_checkpoint
from regressor.network.fast import FastPointRaft
from regressor.network.grouping import GatheredGroups, group_prefix


@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_a_batch_on_a_device_equals_the_fast_form(rng: np.random.Generator, device: str) -> None:
    if device == "cuda" and not torch.cuda.is_available():
        pytest.skip("no CUDA GPU here: the batched form was NOT compared on one")
    model, _ = load_checkpoint()
    sides = [(0.08, 0.06, 0.03), (0.05, 0.05, 0.02), (0.4, 0.05, 0.03), (0.11, 0.07, 0.04)]
    clouds = [(rng.uniform(-0.5, 0.5, (1500, 3)) * side).astype(np.float32) for side in sides]
    groups = [group_prefix(cloud) for cloud in clouds]
    assert [isinstance(group, GatheredGroups) for group in groups] == [False, False, True, False]
    heights = [0.05, 0.03, 0.04, 0.07]
    alone = [FastPointRaft(model).weigh(group, height) for group, height in zip(groups, heights, strict=True)]
    together = BatchedPointRaft(model, device=device).weigh(groups, heights)
    assert together == pytest.approx(alone, rel=1e-4)
    assert BatchedPointRaft(model, device=device).weigh(groups[2:3], heights[2:3]) == pytest.approx(alone[2:3])


@pytest.mark.skipif(torch.cuda.is_available(), reason="a CUDA GPU is here")
def test_a_missing_gpu_is_named() -> None:
    with pytest.raises(InputError, match="finds no CUDA GPU here; use 'cpu'"):
        BatchedPointRaft(load_checkpoint()[0])
