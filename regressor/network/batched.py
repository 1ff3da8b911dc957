"""Many clouds in one pass, for a GPU: the shared-neighbour form on fixed shapes, on any device torch knows.

On a CPU `regressor.network.fast` is quicker, as nothing is gained by batches there. Clouds whose radius binds are
weighed by that form here too. Products of many clouds at once may differ in the last bits from those of one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from regressor.network.device import usable_device
from regressor.network.export import ExportedPointRaft
from regressor.network.fast import FastPointRaft, groups_tensor
from regressor.network.grouping import GatheredGroups, SharedGroups
from regressor.network.pointraft import PointRaft


class BatchedPointRaft:
    """Grams of many clouds at once. Not thread-safe: one instance per worker."""

    def __init__(self, model: PointRaft, *, device: str = "cuda") -> None:
        """`device` as torch names it.

        Raises:
            InputError: this machine or this build of torch does not have it.
        """
        self._device = usable_device(device)
        self._alone = FastPointRaft(model)
        fresh = PointRaft(height_embedding=model.height_embed is not None)
        fresh.load_state_dict(model.state_dict())
        self._network = ExportedPointRaft(fresh).to(self._device)

    def weigh(self, groups: Sequence[SharedGroups | GatheredGroups], heights_m: Sequence[float]) -> NDArray[np.float64]:
        """(n,) grams of n clouds; heights above the belt, clamped, metres."""
        weight_g = np.empty(len(groups))
        together = [i for i, group in enumerate(groups) if isinstance(group, SharedGroups)]
        for i, group in enumerate(groups):
            if isinstance(group, GatheredGroups):
                weight_g[i] = self._alone.weigh(group, heights_m[i])
        if together:
            stacked = np.stack([groups_tensor(group) for group in groups if isinstance(group, SharedGroups)])
            heights = np.array([heights_m[i] for i in together], np.float32)
            with torch.inference_mode():
                points, height = (torch.from_numpy(array).to(self._device) for array in (stacked, heights))
                weight_g[together] = self._network(points, height).cpu().numpy()
        return weight_g
