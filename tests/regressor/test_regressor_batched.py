"""Many clouds at once give what each gives alone, on every device that is here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from conveyor.errors import InputError
from regressor.network.batched import BatchedPointRaft, farthest_points_many
from regressor.network.fast import FastPointRaft
from regressor.network.grouping import GatheredGroups, group_prefix
from regressor.network.sampling import farthest_points
from regressor.network.stored import load_weights
from regressor.weigh.weigher import BATCHED, Weigher, weigh_view, weigh_views
from tests.regressor.ellipsoids import ellipsoid_view


@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_a_batch_on_a_device_equals_the_fast_form(rng: np.random.Generator, device: str) -> None:
    if device == "cuda" and not torch.cuda.is_available():
        pytest.skip("no CUDA GPU here: the batched form was NOT compared on one")
    state, _ = load_weights()
    sides = [(0.08, 0.06, 0.03), (0.05, 0.05, 0.02), (0.4, 0.05, 0.03), (0.11, 0.07, 0.04)]
    clouds = [(rng.uniform(-0.5, 0.5, (1500, 3)) * side).astype(np.float32) for side in sides]
    groups = [group_prefix(cloud) for cloud in clouds]
    assert [isinstance(group, GatheredGroups) for group in groups] == [False, False, True, False]
    heights = [0.05, 0.03, 0.04, 0.07]
    alone = [FastPointRaft(state).weigh(group, height) for group, height in zip(groups, heights, strict=True)]
    together = BatchedPointRaft(state, device=device).weigh(groups, heights)
    assert together == pytest.approx(alone, rel=1e-4)
    assert BatchedPointRaft(state, device=device).weigh(groups[2:3], heights[2:3]) == pytest.approx(alone[2:3])


@pytest.mark.skipif(torch.cuda.is_available(), reason="a CUDA GPU is here")
def test_a_missing_gpu_is_named() -> None:
    with pytest.raises(InputError, match="finds no CUDA GPU here; use 'cpu'"):
        BatchedPointRaft(load_weights()[0])


@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_many_views_at_once_weigh_what_each_weighs_alone(rng: np.random.Generator, device: str) -> None:
    """A worker's whole path: sampling on the device, the network, interval, flags; refusals stay in their place."""
    if device == "cuda" and not torch.cuda.is_available():
        pytest.skip("no CUDA GPU here: the batched path was NOT compared on one")
    axes = [(0.045, 0.03, 0.026), (0.03, 0.025, 0.02), (0.014, 0.012, 0.01), (0.06, 0.04, 0.035)]
    views = [ellipsoid_view(one) for one in axes]
    views.insert(2, replace(views[0], depth=np.zeros_like(views[0].depth)))
    weigher = Weigher.load()
    alone = [weigh_view(weigher, view, regressor="r") for view in views]
    together = weigh_views(weigher.on(device), views, regressor="r")
    assert [weight.status for weight in alone] == ["weighed", "weighed", "refused", "weighed", "weighed"]
    for one, other in zip(alone, together, strict=True):
        flags = (*one.flags, BATCHED) if one.status == "weighed" else ()
        assert replace(other, weight_g=one.weight_g, low_g=one.low_g, high_g=one.high_g) == replace(one, flags=flags)
        if one.weight_g is not None:
            grams = [other.weight_g, other.low_g, other.high_g]
            assert grams == pytest.approx([one.weight_g, one.low_g, one.high_g], rel=1e-4, abs=2e-3)


@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_sampling_many_clouds_picks_what_sampling_each_picks(rng: np.random.Generator, device: str) -> None:
    """Points on a grid of a millimetre have exact ties: the lowest index wins in both."""
    if device == "cuda" and not torch.cuda.is_available():
        pytest.skip("no CUDA GPU here: sampling was NOT compared on one")
    clouds = [rng.integers(0, 40, (n, 3)).astype(np.float32) / 1000 for n in (1, 7, 130, 1500, 3000)]
    padded = np.zeros((len(clouds), 3072, 3), np.float32)
    for row, cloud in zip(padded, clouds, strict=True):
        row[: len(cloud)] = cloud
    lengths = [len(cloud) for cloud in clouds]
    many = farthest_points_many(torch.from_numpy(padded).to(device), lengths, 128).cpu().numpy()
    for order, cloud in zip(many, clouds, strict=True):
        count = min(128, len(cloud))
        np.testing.assert_array_equal(order[:count], farthest_points(cloud, count))
