"""Any trained network behind the weigher's interface, for evaluations that compare networks."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Protocol

import numpy as np
import torch

from conveyor.geometry import TYPICAL_BELT_SD_M
from regressor.network.checkpoint import tensors_of
from regressor.network.networks import POINTNET_POINTS
from regressor.network.pointnet import PointNet
from regressor.network.sampling import farthest_points
from regressor.network.sidecar import Sidecar
from regressor.network.stored import check_architecture, read_weights
from regressor.weigh.prepare import PreparedCloud
from regressor.weigh.volume import TYPICAL_RULE
from regressor.weigh.weigher import Weighed, Weigher, features_of


class Scale(Protocol):
    """What an evaluation needs: something that weighs clouds, and what is known about its weights."""

    @property
    def sidecar(self) -> Sidecar:
        """Of the weights."""

    def weigh(
        self, cloud: PreparedCloud, *, belt_sd_m: float = TYPICAL_BELT_SD_M, resting_sd_m: float = 0.0
    ) -> Weighed:
        """The weight of one prepared cloud."""

    def network_g(self, cloud: PreparedCloud) -> float | None:
        """What the network alone says of it, grams, believed or not; None without one."""


class PointNetScale:
    """PointNet alone: a weight without a calibrated interval, and the volume rule's beside it."""

    def __init__(self, model: PointNet, sidecar: Sidecar) -> None:
        self._model = model.eval()
        self._sidecar = sidecar
        self._volume = sidecar.fitted_volume_rule or TYPICAL_RULE

    @property
    def sidecar(self) -> Sidecar:
        """Of the weights."""
        return self._sidecar

    def weigh(
        self, cloud: PreparedCloud, *, belt_sd_m: float = TYPICAL_BELT_SD_M, resting_sd_m: float = 0.0
    ) -> Weighed:
        """The network's grams; neither sd changes them."""
        weight_g = self.network_g(cloud)
        return Weighed(
            weight_g=weight_g,
            low_g=weight_g,
            high_g=weight_g,
            network_g=weight_g,
            volume_g=float(self._volume.weights_g(features_of(cloud, math.hypot(belt_sd_m, resting_sd_m)))[0]),
            method="pointraft",
            model=self._sidecar.model_id,
            flags=cloud.flags,
            sizes=None,
        )

    def network_g(self, cloud: PreparedCloud) -> float:
        """Grams of the cloud's first 1024 farthest points."""
        points = cloud.points[farthest_points(cloud.points, min(POINTNET_POINTS, len(cloud.points)))]
        with torch.inference_mode():
            return float(self._model(torch.from_numpy(np.ascontiguousarray(points))[None])[0])


def load_scale(path: Path) -> Scale:
    """The weigher of a checkpoint of any network.

    Raises:
        InputError: weights that cannot be used.
    """
    state, sidecar = read_weights(path)
    if sidecar.network != "pointnet":
        return Weigher.load(path)
    model = PointNet()
    expected = {name: tuple(value.shape) for name, value in model.state_dict().items()}
    check_architecture(state, expected, where=str(path), network="PointNet")
    model.load_state_dict(tensors_of(state))
    return PointNetScale(model, sidecar)
