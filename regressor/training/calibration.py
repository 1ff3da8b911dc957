"""What validation views say about the size of errors: a view's interval, what a tuber's views share, what a load does.

Run at the end of a training and again at any time on other views (`tuberline calibrate-interval`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import nnls

from conveyor.camera_range import CAMERAS, GOOD
from conveyor.errors import InputError
from conveyor.statistics import NORMAL_90
from regressor.network.checkpoint import load_checkpoint, save_sidecar
from regressor.network.sidecar import MOST_SHARED, Sidecar
from regressor.studies.metrics import scores
from regressor.training.answers import answers, asked_while_read
from regressor.training.begun import digest_of
from regressor.training.cloudset import CloudSet, evenly, load_cloudset
from regressor.training.labelled import UNKNOWN, part_of
from regressor.training.plausible import refused_told
from regressor.training.tuber_interval import calibrate_tubers
from regressor.training.work import Told, Work, no_work, not_told, preparing
from regressor.weigh.blend import BlendRule
from regressor.weigh.interval import IntervalRule, calibrate, calibrate_cameras
from regressor.weigh.viewscale import BELT, TYPICAL_SLOPES, view_terms
from regressor.weigh.volume import TYPICAL_RULE

MIN_TUBERS = 20
MIN_RECORDINGS = 20
LEAST_BIAS = 0.01
DISTANCE_STEP_M, SITE_STEP_M = 0.05, 0.0005
DISTANCE_MARGIN_M = 0.02
"""Beyond the nearest and the farthest belt of some views: what is no farther away counts as one of theirs."""
VARIED_SHARE, VARIED = 0.05, 1.2
"""Of the views that must know their level better or worse, and by how much, for a slope over that to be fitted."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """How far weights are off: `interval` of one view; see `fused_share` and `load_shares` for the others.

    `tubers`: how many it was made of. `recordings`: how many were counted as independent; 0: the tubers were.
    """

    interval: IntervalRule
    shared_sd_share: float
    shared_bias_share: float
    shared_level_share_per_mm: float
    shared_other_share: float
    recordings: int
    tubers: int

    @property
    def counted(self) -> dict[str, float]:
        """Of what the interval was calibrated on, for a sidecar's `metrics`; see `interval_told`."""
        return {"tubers": float(self.tubers), "recordings": float(self.recordings)}

    def sidecar_keys(self) -> dict[str, Any]:
        """As they stand in a sidecar."""
        return {
            "interval": self.interval.to_json(),
            "shared_sd_share": self.shared_sd_share,
            "shared_bias_share": self.shared_bias_share,
            "shared_level_share_per_mm": self.shared_level_share_per_mm,
            "shared_other_share": self.shared_other_share,
        }


def calibration(
    network_g: NDArray[np.float64],
    volume_g: NDArray[np.float64],
    data: CloudSet,
    *,
    rule: BlendRule,
) -> Calibration:
    """From (n,) grams of the network and of the volume rule on `data`, blended by `rule`.

    What is independent are the recordings; the tubers, where fewer than `MIN_RECORDINGS` recordings are known.
    """
    weight_g = rule.weights_g(network_g, volume_g, data.view_features)
    terms = view_terms(weight_g, network_g, volume_g, data.features, data.height_m, data.level_sd_m)
    recordings = len(np.unique(data.recording))
    belt_slope = None if varied(data.level_sd_m) else TYPICAL_SLOPES[BELT]
    unlike = np.isin(data.preset, list(CAMERAS)) & ~np.isin(data.preset, GOOD)
    if all(len(np.unique(data.recording[kind])) >= MIN_RECORDINGS for kind in (unlike, ~unlike)):
        interval = calibrate_cameras(
            weight_g,
            data.weight_g,
            terms,
            noise_px=data.noise_px,
            features=data.features,
            unlike=unlike,
            recording=data.recording,
            tuber=data.tuber,
            belt_slope=belt_slope,
        )
    elif recordings >= MIN_RECORDINGS:
        interval = calibrate(
            weight_g, data.weight_g, terms, independent=recordings, tuber=data.tuber, belt_slope=belt_slope
        )
    else:
        interval = calibrate_tubers(weight_g, data.weight_g, terms, data.tuber, belt_slope=belt_slope)
    chance = interval.unlike(data.noise_px, data.features)
    interval = replace(interval, farthest_m=round(float(data.belt_distance_m.max()) + DISTANCE_MARGIN_M, 4))
    low_g, high_g = interval.bounds_g(weight_g, terms, chance)
    # A network that has hardly begun to learn is farther off than any scale.
    own, per_mm, other = np.minimum(load_shares(weight_g, data, chance), MOST_SHARED).tolist()
    return Calibration(
        interval=interval,
        shared_sd_share=fused_share(weight_g, low_g, high_g, data.weight_g, data.tuber, level=interval.level),
        shared_bias_share=own,
        shared_level_share_per_mm=per_mm,
        shared_other_share=other,
        recordings=recordings if recordings >= MIN_RECORDINGS else 0,
        tubers=len(np.unique(data.tuber)),
    )


def varied(level_sd_m: NDArray[np.float64]) -> bool:
    """Whether (n,) views know their resting level differently well, so that they show what it does to errors."""
    few, many = np.quantile(level_sd_m, [VARIED_SHARE, 1 - VARIED_SHARE])
    return bool(many > VARIED * few)


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


def load_shares(
    weight_g: NDArray[np.float64], data: CloudSet, unlike: NDArray[np.float64]
) -> tuple[float, float, float]:
    """(own, per mm, other): half of the 90 % interval of what all tubers of a load share, as shares of its weight.

    The bias of the total differs between recordings by more than their tubers' number explains: that part does not
    shrink with the count. Its square is own^2, plus (per mm times the standard deviation of the resting level)^2, plus
    other^2 as far as the recording's views are of cameras unlike good ones (`unlike`: (n,) chances); own,
    cultivar and what the weights misjudge, is at least 1 %. Where recordings are unknown, stock, distance and site
    stand for them and all of it is the load's own.
    """
    known = not (data.recording == UNKNOWN).all() and len(np.unique(data.recording)) >= MIN_RECORDINGS
    load = data.recording if known else _stocks(data)
    bias, chance, weight, level_mm, other = [], [], [], [], []
    for name in np.unique(load):
        rows = load == name
        _, owner = np.unique(data.tuber[rows], return_inverse=True)
        count = np.bincount(owner)
        if len(count) < MIN_TUBERS:
            continue
        error = np.bincount(owner, (weight_g - data.weight_g)[rows]) / count
        total = float((np.bincount(owner, data.weight_g[rows]) / count).sum())
        bias.append(float(error.sum()) / total)
        chance.append(len(count) * float(error.var(ddof=1)) / total**2)
        weight.append(len(count))
        level_mm.append(1e3 * float(np.sqrt(np.mean(data.level_sd_m[rows] ** 2))))
        other.append(float(unlike[rows].mean()))
    if not bias:
        return 0.05, 0.0, 0.0
    excess = np.square(bias) - np.array(chance)
    if not known:
        shared = float(np.average(excess, weights=weight))
        return round(max(LEAST_BIAS, NORMAL_90 * float(np.sqrt(max(shared, 0.0)))), 4), 0.0, 0.0
    design = np.column_stack([np.ones(len(excess)), np.square(level_mm), np.square(other)])
    own, per_mm, of_others = NORMAL_90 * np.sqrt(nnls(design, excess)[0])
    return round(max(LEAST_BIAS, float(own)), 4), round(float(per_mm), 5), round(float(of_others), 4)


def _stocks(data: CloudSet) -> NDArray[np.str_]:
    distance = np.round(data.belt_distance_m / DISTANCE_STEP_M).astype(np.int64)
    site = np.round(data.level_sd_m / SITE_STEP_M).astype(np.int64)
    return np.array(["/".join(map(str, name)) for name in zip(data.cultivar, data.season, distance, site, strict=True)])


def check_unlearned(views: CloudSet, sidecar: Sidecar, where: str, harm: str) -> None:
    """Refuse the views that a network was trained on. `where`: which these are; `harm`: what would come of them.

    Raises:
        InputError: they are its training's.
    """
    learned = sidecar.training.get("data")
    if learned is not None and learned in (digest_of(views), digest_of(views.subset(views.clean))):
        raise InputError(
            f"{where}: a network answers the views that it has learned too well, and {harm}. Give tubers that no "
            "training has seen"
        )


def recalibrate(
    weights: Path,
    data: Path,
    *,
    cache: Path | None,
    max_views: int | None,
    compute: torch.dtype | None = None,
    on_work: Work = no_work,
    on_left_out: Told = not_told,
) -> Sidecar:
    """Calibrate saved weights again on the views of `data` and write their sidecar; the tensors stay as they are.

    Of a folder with a splits.csv the part 'val' is read.

    Raises:
        InputError: weights without a sidecar of their own, views that cannot be used, or those of the training.
    """
    model, sidecar = load_checkpoint(weights, any_target=True)
    if weights.suffix != ".safetensors" or not weights.with_suffix(".json").is_file():
        raise InputError(f"{weights} has no sidecar to calibrate: `tuberline import-checkpoint` makes one")
    split = part_of(data, "val")
    views = load_cloudset(
        data,
        split=split,
        cache=cache,
        asked=asked_while_read(model, sidecar, compute=compute),
        progress=preparing(data, on_work, split=split),
    )
    views = views.with_target(sidecar.target)
    if left_out := refused_told(views.refused, views.refused_first):
        on_left_out(data, left_out)
    check_unlearned(views, sidecar, f"{data} is what {weights} were trained on", "intervals would be too narrow")
    views = evenly(views, max_views)
    network_g = answers(model, sidecar, views, compute=compute, on_work=on_work)
    volume_g = (sidecar.fitted_volume_rule or TYPICAL_RULE).weights_g(views.view_features)
    rule = sidecar.blend_rule
    found = calibration(network_g, volume_g, views, rule=rule)
    weight_g = rule.weights_g(network_g, volume_g, views.view_features)
    figures = scores(weight_g, views.weight_g, views.tuber)
    metrics = {**sidecar.metrics, "calibration": figures, "interval": found.counted}
    return save_sidecar(weights, sidecar.model_copy(update={**found.sidecar_keys(), "metrics": metrics}))
