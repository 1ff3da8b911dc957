"""Many clouds at once give what each gives alone, on every device that is here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from conveyor.errors import InputError
from regressor.network import batched
from regressor.network.batched import WIDTHS, BatchedPointRaft, Sampler, sample_by_operations
from regressor.network.fast import FastPointRaft
from regressor.network.grouping import GatheredGroups, group_prefix, group_random
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
    # Of up to 2048 points they have 188 and 256 centroids: they could not be laid side by side.
    more = [group_random(np.resize(clouds[0], (n, 3)), seed=1, points=2048) for n in (1500, 3000)]
    alone = [FastPointRaft(state).weigh(group, 0.05) for group in more]
    together = BatchedPointRaft(state, device=device, points=2048).weigh(more, [0.05, 0.05])
    assert together == pytest.approx(alone, rel=1e-4)


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


def _sample_of(by: str) -> Sampler:
    if by != "the kernel":
        return sample_by_operations
    from regressor.network.sampling_gpu import sample_by_kernel

    return sample_by_kernel


@pytest.mark.parametrize(("width", "beyond"), [(4096, ()), (16384, (9000, 16384)), (65536, (60000,))])
@pytest.mark.parametrize("by", ["operations on the CPU", "operations on a GPU", "the kernel"])
def test_sampling_many_clouds_picks_what_sampling_each_picks(
    rng: np.random.Generator, by: str, width: int, beyond: tuple[int, ...]
) -> None:
    """Points on a grid of a millimetre have exact ties: the lowest index wins in all. Others tell a fused sum."""
    device = torch.device("cpu" if by.endswith("CPU") else "cuda")
    if device.type == "cuda" and not torch.cuda.is_available():
        pytest.skip(f"no CUDA GPU here: sampling by {by} was NOT compared on one")
    grid = [rng.integers(0, 40, (n, 3)).astype(np.float32) / 1000 for n in (1, 7, 130, 1500, 3000)]
    clouds = [*grid, *((rng.normal(size=(n, 3)) * 0.03).astype(np.float32) for n in (900, 4096))]
    clouds += [(rng.normal(size=(n, 3)) * 0.03).astype(np.float32) for n in beyond]
    lengths = [len(cloud) for cloud in clouds]
    given = (np.concatenate(clouds), np.cumsum([0, *lengths[:-1]]), np.array(lengths))
    sample = _sample_of(by)
    many, span = sample(*(torch.from_numpy(part).to(device) for part in given), count=128, width=width)
    assert np.array_equal(span.cpu().numpy(), [np.ptp(cloud, axis=0) for cloud in clouds])
    many = many.cpu().numpy()
    for order, cloud in zip(many, clouds, strict=True):
        count = min(128, len(cloud))
        np.testing.assert_array_equal(order[:count], farthest_points(cloud, count))


@pytest.mark.parametrize("points", [512, 1024, 2048])
@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_clouds_sampled_together_are_grouped_as_each_alone(rng: np.random.Generator, device: str, points: int) -> None:
    """Small clouds, whose groups are padded, large ones, one in which a radius binds, and a pass that is not full; a
    second pass of the same shape knows nothing of the first. Of 2048 points, half of the centroids were left out.
    """
    if device == "cuda" and not torch.cuda.is_available():
        pytest.skip("no CUDA GPU here: passes were NOT compared on one")
    state, _ = load_weights()
    together, alone = BatchedPointRaft(state, device=device, points=points), FastPointRaft(state)
    many = (5000, 4200, 900, 6000, 30, 4100, 7000)
    for sizes in ((3, 1800, 700, 2500, 90), (2600, 40, 1030, 1, 600), many, many[::-1][:5]):
        clouds = [(rng.uniform(-0.5, 0.5, (n, 3)) * (0.08, 0.06, 0.03)).astype(np.float32) for n in sizes]
        clouds[1] *= 4
        heights = rng.uniform(0.02, 0.07, len(clouds)).tolist()
        groups = [group_prefix(cloud, points=points) for cloud in clouds]
        expected = [alone.weigh(group, height) for group, height in zip(groups, heights, strict=True)]
        assert together.weigh_clouds(clouds, heights) == pytest.approx(expected, rel=1e-4, abs=2e-3)


def test_a_cloud_too_large_for_a_pass_is_weighed_alone(rng: np.random.Generator) -> None:
    state, _ = load_weights()
    cloud = (rng.uniform(-0.5, 0.5, (WIDTHS[-1] + 1, 3)) * (0.08, 0.06, 0.03)).astype(np.float32)
    expected = FastPointRaft(state).weigh(group_prefix(cloud), 0.05)
    assert BatchedPointRaft(state, device="cpu").weigh_clouds([cloud], [0.05]) == pytest.approx([expected], rel=1e-4)


@pytest.mark.parametrize(("most", "most_points"), [(4, batched.MOST_POINTS), (batched.MOST, 100)])
def test_more_clouds_than_a_pass_holds_are_all_weighed(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, most: int, most_points: int
) -> None:
    """More clouds, or more points."""
    monkeypatch.setattr(batched, "MOST", most)
    monkeypatch.setattr(batched, "MOST_POINTS", most_points)
    state, _ = load_weights()
    clouds = [(rng.uniform(-0.5, 0.5, (30, 3)) * (0.08, 0.06, 0.03)).astype(np.float32) for _ in range(7)]
    alone = FastPointRaft(state)
    together = BatchedPointRaft(state, device="cuda" if torch.cuda.is_available() else "cpu")
    expected = [alone.weigh(group_prefix(cloud), 0.04) for cloud in clouds]
    assert together.weigh_clouds(clouds, [0.04] * 7) == pytest.approx(expected, rel=1e-4)
