"""All that makes a weight as one graph, for export: the network, the volume rule, their blend and the interval.

The same arithmetic as `volume.py`, `blend.py`, `viewscale.py` and `interval.py`, in torch and float64, so that another
program gets from one file what a line books. `tests/regressor/test_regressor_export.py` holds both to each other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from conveyor.statistics import NORMAL_90
from regressor.network.sidecar import Sidecar
from regressor.weigh.blend import MOST_CORRECTION, BlendRule
from regressor.weigh.interval import FARTHER, IntervalRule
from regressor.weigh.quadratic import UNITS, QuadraticRule
from regressor.weigh.surface import NAMES
from regressor.weigh.unlike import HOLES, LEAST_PX, MANY_HOLES, MUCH_PX, TYPICAL_PX, CameraRule
from regressor.weigh.view_features import LEAST_PX as LEAST_NOISE_PX
from regressor.weigh.view_features import LEAST_SD_MM, MOST_SD_MM, VIEW_NAMES
from regressor.weigh.view_features import MOST_PX as MOST_NOISE_PX
from regressor.weigh.view_features import TYPICAL_PX as TYPICAL_NOISE_PX
from regressor.weigh.viewscale import OWN_ERROR, TYPICAL_G, ScaleRule
from regressor.weigh.volume import TYPICAL_RULE, VolumeRule, limits_of

INPUTS = ("groups", "height_m", "features", "belt_sd_m", "noise_px", "belt_distance_m")
OUTPUTS = ("weight_g", "low_g", "high_g", "network_g", "volume_g")


class WeighingGraph(nn.Module):
    """Weights of B clouds, as a ledger has those of single views."""

    def __init__(self, network: nn.Module, sidecar: Sidecar) -> None:
        super().__init__()
        self.network = network
        self._highest_m = sidecar.input.max_height_m
        self._volume = sidecar.fitted_volume_rule or TYPICAL_RULE
        self._blend = sidecar.blend_rule
        self._interval = sidecar.interval_rule
        self.eval()

    def forward(
        self,
        groups: Tensor,
        height_m: Tensor,
        features: Tensor,
        belt_sd_m: Tensor,
        noise_px: Tensor,
        belt_distance_m: Tensor,
    ) -> tuple[Tensor, ...]:
        """(B,) grams each, in the order of `OUTPUTS`.

        Args:
            groups: (B, 256, 3) float32, as `groups_tensor` lays them out. height_m: (B,) float32 above the resting
                level. features: (B, 35) float64 in the order of `surface.NAMES`. belt_sd_m, noise_px: (B,) float64; a
                noise of 0 is one that is not known. belt_distance_m: (B,) float64, from the camera to the belt.
        """
        network_g = self.network(groups, height_m.clamp(0.0, self._highest_m)).double()
        view = view_features(features, noise_px, belt_sd_m)
        volume_g = volume_rule(self._volume, view)
        weight_g = blended(self._blend, network_g, volume_g, view)
        terms = view_terms(weight_g, network_g, volume_g, features, height_m.double(), belt_sd_m)
        low_g, high_g = self._bounds(weight_g, terms, features, noise_px, belt_distance_m)
        # A network that fails is not believed: the visible volume weighs alone.
        fine = network_g > 0
        factor = math.exp(NORMAL_90 * max(self._volume.residual_ln_sd, 0.05))
        return (
            torch.where(fine, weight_g, volume_g),
            torch.where(fine, low_g, volume_g / factor),
            torch.where(fine, high_g, volume_g * factor),
            network_g,
            volume_g,
        )

    def _bounds(
        self, weight_g: Tensor, terms: Tensor, features: Tensor, noise_px: Tensor, distance_m: Tensor
    ) -> tuple[Tensor, Tensor]:
        rule = self._interval
        # An input that nothing reads would not be one of the exported graph's.
        idle = 0.0 * (noise_px + terms[:, 0] + distance_m)
        if rule is None:
            return 0.7 * weight_g + idle, 1.3 * weight_g
        below, above = reach(rule, weight_g, terms)
        if rule.camera is not None and rule.other is not None:
            unlike = camera_rule(rule.camera, noise_px, features)
            others = reach(rule.other, weight_g, terms)
            below, above = below + unlike * (others[0] - below), above + unlike * (others[1] - above)
        farthest_m = math.inf if rule.farthest_m is None else rule.farthest_m
        wider = (distance_m / farthest_m).clamp(min=1.0) ** FARTHER
        return (weight_g + wider * below + idle).clamp(min=0.0), weight_g + wider * above


def view_features(features: Tensor, noise_px: Tensor, level_sd_m: Tensor) -> Tensor:
    """(B, 37); as `view_features.view_features`, a noise of 0 being one that is not known."""
    noise = torch.where(noise_px > 0, noise_px, TYPICAL_NOISE_PX * _one(noise_px)).clamp(LEAST_NOISE_PX, MOST_NOISE_PX)
    level_sd_mm = (1e3 * level_sd_m).clamp(LEAST_SD_MM, MOST_SD_MM)
    return torch.cat([features, noise[:, None], level_sd_mm[:, None]], dim=1)


def volume_rule(rule: VolumeRule, features: Tensor) -> Tensor:
    """(B,) grams; as `VolumeRule.weights_g`."""
    terms = _terms(features, rule.names)
    if rule.low:
        terms = _between(terms, *(limit.tolist() for limit in limits_of(rule)))
    ln_g = rule.intercept + terms @ _row(rule.coefficients)
    if rule.products:
        ln_g = ln_g + _pairs(terms, rule.low, rule.high) @ _row(rule.products)
    return ln_g.clamp(-5.0, 12.0).exp()


def blended(rule: BlendRule, network_g: Tensor, volume_g: Tensor, features: Tensor) -> Tensor:
    """(B,) grams; as `BlendRule.weights_g`."""
    ln_g = network_g.clamp(min=1e-3).log() * (1 - rule.share) + volume_g.log() * rule.share
    if rule == BlendRule(rule.share):
        return ln_g.exp()
    ln_g = ln_g.clamp(min=math.log(1e-3))
    correction = rule.intercept + rule.slope * (ln_g - rule.middle)
    for slope, seen in zip(rule.slopes, rule.seen, strict=True):
        correction = correction + slope * quadratic_rule(seen, features)
    return (ln_g + correction.clamp(-MOST_CORRECTION, MOST_CORRECTION)).exp()


def quadratic_rule(rule: QuadraticRule, features: Tensor) -> Tensor:
    """(B,); as `QuadraticRule.values`."""
    terms = _between(_terms(features, rule.names), rule.low, rule.high)
    found = rule.intercept + terms @ _row(rule.coefficients) + _pairs(terms, rule.low, rule.high) @ _row(rule.products)
    return found.clamp(rule.least, rule.most)


def view_terms(
    weight_g: Tensor, network_g: Tensor, volume_g: Tensor, features: Tensor, height_m: Tensor, sd_m: Tensor
) -> Tensor:
    """(B, 6); as `viewscale.view_terms`."""
    length, width, volume, area = (
        features[:, NAMES.index(name)].clamp(min=1.0) for name in ("length_mm", "width_mm", "volume_ml", "area_cm2")
    )
    ln_weight = (weight_g.clamp(min=1.0) / TYPICAL_G).log()
    disagreement = (network_g.clamp(min=1.0) / volume_g.clamp(min=1.0)).log().abs()
    steepness = ((1e3 * height_m).clamp(min=5.0) / width).log()
    belt = (1 + (100 * sd_m * area / volume / OWN_ERROR) ** 2).sqrt().log()
    return torch.stack([ln_weight, ln_weight**2, disagreement, (length / width).log(), steepness, belt], dim=1)


def scale_rule(rule: ScaleRule, terms: Tensor) -> Tensor:
    """(B,) grams; as `ScaleRule.scale_g`."""
    return (rule.intercept + _between(terms, rule.low, rule.high) @ _row(rule.slopes)).exp()


def camera_rule(rule: CameraRule, noise_px: Tensor, features: Tensor) -> Tensor:
    """(B,) chances; as `CameraRule.chance`."""
    noise = torch.where(noise_px > 0, noise_px, TYPICAL_PX * _one(noise_px)).clamp(min=LEAST_PX)
    holes = features[:, HOLES]
    terms = [
        (noise / TYPICAL_PX).log(),
        (noise / MUCH_PX).clamp(min=1.0).log(),
        holes.sqrt(),
        (holes / MANY_HOLES).clamp(max=1.0),
    ]
    return torch.sigmoid(rule.intercept + torch.stack(terms, dim=1) @ _row(rule.slopes))


def reach(rule: IntervalRule, weight_g: Tensor, terms: Tensor) -> tuple[Tensor, Tensor]:
    """((B,) at most 0, (B,) at least 0) grams from a weight to its bounds; as in `IntervalRule.bounds_g`."""
    scale = _one(weight_g) if rule.scale is None else scale_rule(rule.scale, terms)
    below = (scale * _interpolated(weight_g, rule.at_g, rule.below_g)).clamp(max=0.0)
    above = (scale * _interpolated(weight_g, rule.at_g, rule.above_g)).clamp(min=0.0)
    return below, above


def _interpolated(x: Tensor, at: Sequence[float], values: Sequence[float]) -> Tensor:
    """np.interp: (B,), constant beyond both ends."""
    found = values[0] * _one(x)
    for index in range(len(at) - 1):
        wide = at[index + 1] - at[index]
        found = found + (x - at[index]).clamp(0.0, wide) * ((values[index + 1] - values[index]) / wide)
    return found


def _terms(features: Tensor, names: Sequence[str]) -> Tensor:
    columns = [features[:, VIEW_NAMES.index(name)] for name in names]
    logs = [c.clamp(min=1e-3).log() if n.endswith(UNITS) else c for n, c in zip(names, columns, strict=True)]
    return torch.stack(logs, dim=1)


def _pairs(terms: Tensor, low: Sequence[float], high: Sequence[float]) -> Tensor:
    span = torch.tensor(np.maximum(np.subtract(high, low), 1e-9))
    scaled = 2 * (_between(terms, low, high) - _row(low)) / span - 1
    first, second = (torch.from_numpy(index) for index in np.triu_indices(len(low)))
    return scaled[:, first] * scaled[:, second]


def _between(values: Tensor, low: Sequence[float], high: Sequence[float]) -> Tensor:
    return torch.minimum(torch.maximum(values, _row(low)), _row(high))


def _row(values: Sequence[float]) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def _one(like: Tensor) -> Tensor:
    return torch.ones_like(like)
