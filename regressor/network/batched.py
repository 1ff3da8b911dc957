"""Many clouds in one pass, for a GPU: sampling and the shared-neighbour form on fixed shapes, on any torch device.

On a CPU `regressor.network.fast` is quicker, as nothing is gained by batches there; the same code runs on it, and is
tested there. Clouds whose radius binds are weighed by that form here too. Products of many clouds at once may differ
in the last bits from those of one; the points that are picked never do.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from regressor.network.architecture import NEIGHBOURS
from regressor.network.checkpoint import model_of
from regressor.network.device import usable_device
from regressor.network.export import ExportedPointRaft
from regressor.network.fast import FastPointRaft, groups_tensor
from regressor.network.grouping import (
    CENTROIDS_2,
    CLOUD_POINTS,
    GatheredGroups,
    SharedGroups,
    group_prefix,
    radius_is_free_of,
    stage_counts,
)
from regressor.network.stored import State

PADDED_TO = 1024
"""Clouds of a batch are padded to a multiple of this many points: few shapes, so that a graph is captured seldom."""


class BatchedPointRaft:
    """Grams of many clouds at once. Not thread-safe: one instance per worker."""

    def __init__(self, state: State, *, device: str = "cuda") -> None:
        """`state`: parameters as `load_weights` gives them; `device` as torch names it.

        Raises:
            InputError: this machine or this build of torch does not have it.
        """
        self._device = usable_device(device)
        self._alone = FastPointRaft(state)
        self._network = ExportedPointRaft(model_of(state)).to(self._device)

    def weigh(self, groups: Sequence[SharedGroups | GatheredGroups], heights_m: Sequence[float]) -> NDArray[np.float64]:
        """(n,) grams of n clouds; heights above the belt, clamped, metres."""
        weight_g = np.empty(len(groups))
        together = [i for i, group in enumerate(groups) if isinstance(group, SharedGroups)]
        for i, group in enumerate(groups):
            if isinstance(group, GatheredGroups):
                weight_g[i] = self._alone.weigh(group, heights_m[i])
        if together:
            stacked = np.stack([groups_tensor(group) for group in groups if isinstance(group, SharedGroups)])
            weight_g[together] = self._forward(torch.from_numpy(stacked), [heights_m[i] for i in together])
        return weight_g

    def weigh_clouds(
        self, clouds: Sequence[NDArray[np.float32]], heights_m: Sequence[float], *, points: int = CLOUD_POINTS
    ) -> NDArray[np.float64]:
        """(n,) grams of n clouds, each (N, 3), centred, metres, sampled here from its first point on (`group_prefix`).

        `points`: how many the network is given of a larger cloud.
        """
        free = [radius_is_free_of(cloud) for cloud in clouds]
        weight_g = np.empty(len(clouds))
        for i, cloud in enumerate(clouds):
            if not free[i]:
                weight_g[i] = self.weigh([group_prefix(cloud, points=points)], [heights_m[i]])[0]
        together = [i for i, is_free in enumerate(free) if is_free]
        if together:
            groups = self._groups([clouds[i] for i in together], points)
            weight_g[together] = self._forward(groups, [heights_m[i] for i in together])
        return weight_g

    def _groups(self, clouds: Sequence[NDArray[np.float32]], points: int) -> Tensor:
        """(n, 256, 3) float32 on the device, as `groups_tensor` lays them out."""
        lengths = [len(cloud) for cloud in clouds]
        longest = -(-max(lengths) // PADDED_TO) * PADDED_TO
        padded = np.zeros((len(clouds), longest, 3), np.float32)
        for row, cloud in zip(padded, clouds, strict=True):
            row[: len(cloud)] = cloud
        on_device = torch.from_numpy(padded).to(self._device)
        counts = [stage_counts(min(length, points)) for length in lengths]
        picked = [
            min(min(length, points), max(NEIGHBOURS, count2))
            for length, (_, count2) in zip(lengths, counts, strict=True)
        ]
        with torch.inference_mode():
            order = farthest_points_many(on_device, lengths, max(picked))
            # Groups are padded by repetition: which pick stands at each of the 256 places.
            places = np.stack(
                [
                    np.concatenate(
                        [
                            np.resize(np.arange(min(NEIGHBOURS, n)), NEIGHBOURS),
                            np.resize(np.arange(min(NEIGHBOURS, count1, n)), NEIGHBOURS),
                            np.resize(np.arange(min(count2, n)), CENTROIDS_2),
                        ]
                    )
                    for n, (count1, count2) in zip(picked, counts, strict=True)
                ]
            )
            at = order.gather(1, torch.from_numpy(places).to(self._device))
            return on_device.gather(1, at[..., None].expand(-1, -1, 3))

    def _forward(self, groups: Tensor, heights_m: Sequence[float]) -> NDArray[np.float64]:
        with torch.inference_mode():
            height = torch.tensor(heights_m, dtype=torch.float32, device=self._device)
            weights: NDArray[np.float64] = self._network(groups.to(self._device), height).double().cpu().numpy()
        return weights


def farthest_points_many(clouds: Tensor, lengths: Sequence[int], count: int) -> Tensor:
    """Greedy farthest-point sampling of many clouds at once, each from its first point, ties as in `farthest_points`.

    Args:
        clouds: (B, N, 3) float32, rows beyond a cloud's length are padding.
        lengths: points of each cloud, 1..N.
        count: how many to pick of each; beyond its length a cloud's picks say nothing.

    Returns:
        (B, count) int64 indices in the order of selection.
    """
    x, y, z = (clouds[..., axis].contiguous() for axis in range(3))
    batch, width = x.shape
    length = torch.tensor(lengths, device=clouds.device)[:, None]
    nearest = torch.where(torch.arange(width, device=clouds.device)[None] < length, torch.inf, -1.0)
    order = torch.zeros((batch, count), dtype=torch.int64, device=clouds.device)
    last = order[:, :1]
    for pick in range(1, count):
        dx, dy, dz = (axis - axis.gather(1, last) for axis in (x, y, z))
        # Each product and each sum rounded by itself, as the kernel for one cloud does it.
        nearest = torch.minimum(nearest, dx * dx + dy * dy + dz * dz)
        last = nearest.argmax(dim=1, keepdim=True)  # the first of equal ones
        order[:, pick] = last[:, 0]
    return order
