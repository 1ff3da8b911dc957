"""What validation views say about the size of errors: a view's interval, what a tuber's views share, what a load does.

Run at the end of a training and again at any time on other views (`tuberline calibrate-interval`).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError
from conveyor.statistics import NORMAL_90
from regressor.network.checkpoint import Sidecar, load_checkpoint, save_checkpoint
from regressor.network.grouping import stage_counts
from regressor.network.pointraft import NEIGHBOURS
from regressor.network.reduced import Resolution
from regressor.studies.metrics import scores
from regressor.training.cloudset import CloudSet, load_cloudset
from regressor.training.train import predict
from regressor.weigh.interval import IntervalRule, calibrate
from regressor.weigh.viewscale import view_terms
from regressor.weigh.volume import TYPICAL_RULE, blend

MIN_TUBERS = 20
LEAST_BIAS = 0.01
DISTANCE_STEP_M, SITE_STEP_M = 0.05, 0.0005


@dataclass(frozen=True, slots=True)
class Calibration:
    """How far weights are off: `interval` of one view; see `fused_share` and `load_share` for the other two."""

    interval: IntervalRule
    shared_sd_share: float
    shared_bias_share: float

    def sidecar_keys(self) -> dict[str, Any]:
        """As they stand in a sidecar."""
        return {
            "interval": self.interval.to_json(),
            "shared_sd_share": self.shared_sd_share,
            "shared_bias_share": self.shared_bias_share,
        }


def calibration(
    network_g: NDArray[np.float64], volume_g: NDArray[np.float64], data: CloudSet, *, volume_share: float
) -> Calibration:
    """From (n,) grams of the network and of the volume rule on `data`, blended by `volume_share`."""
    weight_g = blend(network_g, volume_g, volume_share)
    terms = view_terms(weight_g, network_g, volume_g, data.features, data.height_m, data.belt_sd_m)
    rule = calibrate(weight_g, data.weight_g, terms)
    low_g, high_g = rule.bounds_g(weight_g, terms)
    return Calibration(
        interval=rule,
        shared_sd_share=fused_share(weight_g, low_g, high_g, data.weight_g, data.tuber, level=rule.level),
        shared_bias_share=load_share(weight_g, data),
    )


def fused_share(
    weight_g: NDArray[np.float64],
    low_g: NDArray[np.float64],
    high_g: NDArray[np.float64],
    truth_g: NDArray[np.float64],
    tuber: NDArray[np.str_],
    *,
    level: float,
) -> float:
    """The share s, 0..1, with which the intervals of fused tubers hold `level` of them.

    n fused views have their mean interval times `sqrt(s^2 + (1 - s^2) / n)`: s is what a tuber's views share of their
    error's standard deviation, found as the conformal quantile over tubers instead of from the errors' variances.
    """
    _, owner = np.unique(tuber, return_inverse=True)
    count = np.bincount(owner)
    middle, truth, low, high = (np.bincount(owner, v) / count for v in (weight_g, truth_g, low_g, high_g))
    half = np.maximum(np.where(truth >= middle, high - middle, middle - low), 1e-6)
    several = count > 1
    if several.sum() < MIN_TUBERS:
        return 1.0
    needed = (((truth - middle) / half)[several] ** 2 - 1 / count[several]) / (1 - 1 / count[several])
    position = min(1.0, np.ceil((several.sum() + 1) * level) / several.sum())
    return round(float(np.sqrt(np.clip(np.quantile(needed, position), 0.0, 1.0))), 4)


def load_share(weight_g: NDArray[np.float64], data: CloudSet) -> float:
    """Half of the 90 % interval of what all tubers of a load have in common, as a share of its weight; at least 1 %.

    The bias of the total differs between stocks (cultivar, season, belt distance) and sites (how well the belt is
    known, and what goes with it) by more than their numbers explain: that part does not shrink with the count.
    """
    distance = np.round(data.belt_distance_m / DISTANCE_STEP_M).astype(np.int64)
    site = np.round(data.belt_sd_m / SITE_STEP_M).astype(np.int64)
    names = zip(data.cultivar, data.season, distance, site, strict=True)
    stock = np.array(["/".join(map(str, name)) for name in names])
    bias, chance, weight = [], [], []
    for name in np.unique(stock):
        rows = stock == name
        _, owner = np.unique(data.tuber[rows], return_inverse=True)
        count = np.bincount(owner)
        if len(count) < MIN_TUBERS:
            continue
        error = np.bincount(owner, (weight_g - data.weight_g)[rows]) / count
        total = float((np.bincount(owner, data.weight_g[rows]) / count).sum())
        bias.append(float(error.sum()) / total)
        chance.append(len(count) * float(error.var(ddof=1)) / total**2)
        weight.append(len(count))
    if not bias:
        return 0.05
    shared = float(np.average(np.square(bias) - np.array(chance), weights=weight))
    return round(max(LEAST_BIAS, NORMAL_90 * float(np.sqrt(max(shared, 0.0)))), 4)


def recalibrate(weights: Path, data: Path, *, cache: Path | None, max_views: int | None) -> Sidecar:
    """Calibrate saved weights anew on the views of `data` and write their sidecar; the tensors stay as they are.

    Raises:
        InputError: weights without a sidecar of their own, or views that cannot be used.
    """
    model, sidecar = load_checkpoint(weights, any_target=True)
    if weights.suffix != ".safetensors" or not weights.with_suffix(".json").is_file():
        raise InputError(f"{weights} has no sidecar to calibrate: `tuberline import-checkpoint` makes one")
    views = load_cloudset(data, cache=cache, max_views=max_views).with_target(sidecar.target)
    resolution = Resolution(NEIGHBOURS, stage_counts(sidecar.input.points)[1])
    network_g = predict(model, views, highest_m=sidecar.input.max_height_m, resolution=resolution)
    volume_g = (sidecar.fitted_volume_rule or TYPICAL_RULE).weights_g(views.features)
    found = calibration(network_g, volume_g, views, volume_share=sidecar.volume_share)
    weight_g = blend(network_g, volume_g, sidecar.volume_share)
    metrics = {**sidecar.metrics, "calibration": scores(weight_g, views.weight_g, views.tuber)}
    return save_checkpoint(
        weights, model.state_dict(), sidecar.model_copy(update={**found.sidecar_keys(), "metrics": metrics})
    )
