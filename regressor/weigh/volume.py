"""The volume under the visible surface, and a weight from it: the fallback when no network fits, and its check.

`V_top = sum((H - z) * area of the pixel at depth z)` is the volume between the visible surface and the belt. With the
outline's area and axes and the height it predicts weight far better than the paper's box does (docs/pointraft.md).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

CELL_M = 0.003
NAMES = ("volume_ml", "area_cm2", "length_mm", "width_mm", "height_mm")


@dataclass(frozen=True, slots=True)
class SurfaceFeatures:
    """What the visible surface measures: volume down to the belt, outline area, sorted outline axes, height (p99)."""

    volume_ml: float
    area_cm2: float
    length_mm: float
    width_mm: float
    height_mm: float

    def as_array(self) -> NDArray[np.float64]:
        """(5,) float64 in the order of `NAMES`."""
        return np.array([getattr(self, name) for name in NAMES])


def surface_features_of_pixels(
    level_xy: NDArray[np.float64], heights_m: NDArray[np.float64], areas_m2: NDArray[np.float64]
) -> SurfaceFeatures:
    """Features of the pixels of a depth image.

    Args:
        level_xy: (N, 2) metres in a plane parallel to the belt. heights_m: (N,) above the belt.
        areas_m2: (N,) area on that plane that each pixel covers.
    """
    volume_m3 = float((np.maximum(heights_m, 0.0) * areas_m2).sum())
    length_m, width_m = _axes(level_xy)
    return SurfaceFeatures(
        volume_ml=volume_m3 * 1e6,
        area_cm2=float(areas_m2.sum()) * 1e4,
        length_mm=length_m * 1e3,
        width_mm=width_m * 1e3,
        height_mm=float(np.quantile(heights_m, 0.99)) * 1e3,
    )


def surface_features_of_cloud(level_xy: NDArray[np.float64], heights_m: NDArray[np.float64]) -> SurfaceFeatures:
    """Features of a cloud whose pixels are unknown: the points' mean height in each 3 mm cell of the plane."""
    cell = np.floor(level_xy / CELL_M).astype(np.int64)
    _, owner = np.unique(cell, axis=0, return_inverse=True)
    count = np.bincount(owner)
    mean = np.bincount(owner, weights=heights_m) / count
    # A cell at the rim is only partly covered: it counts by how full it is.
    share = np.minimum(1.0, count / max(float(np.median(count)), 1.0))
    area = CELL_M * CELL_M * share
    base = surface_features_of_pixels(level_xy, heights_m, np.zeros(len(heights_m)))
    return SurfaceFeatures(
        volume_ml=float((np.maximum(mean, 0.0) * area).sum()) * 1e6,
        area_cm2=float(area.sum()) * 1e4,
        length_mm=base.length_mm,
        width_mm=base.width_mm,
        height_mm=base.height_mm,
    )


def _axes(level_xy: NDArray[np.float64]) -> tuple[float, float]:
    """Longest and shortest width of the outline over 36 directions in the plane, metres."""
    angle = np.deg2rad(np.arange(0.0, 180.0, 5.0))
    along = level_xy[:: max(1, len(level_xy) // 2000)] @ np.stack([np.cos(angle), np.sin(angle)])
    widths = np.quantile(along, 0.995, axis=0) - np.quantile(along, 0.005, axis=0)
    longest = int(widths.argmax())
    return float(widths[longest]), float(widths[(longest + 18) % 36])


@dataclass(frozen=True, slots=True)
class VolumeRule:
    """ln weight = intercept + sum(coefficients * ln features), fitted on a training set; `sd` of the residual's ln."""

    intercept: float
    coefficients: tuple[float, ...]
    residual_ln_sd: float
    names: tuple[str, ...] = NAMES

    def weight_g(self, features: SurfaceFeatures) -> float:
        """Grams."""
        return float(self.weights_g(features.as_array()[None])[0])

    def weights_g(self, features: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) grams of (n, 5) features in the order of `NAMES`."""
        logs = np.log(np.maximum(features, 1e-3))
        weights: NDArray[np.float64] = np.exp(self.intercept + logs @ np.array(self.coefficients))
        return weights

    def to_json(self) -> dict[str, Any]:
        """For the sidecar of a checkpoint."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> VolumeRule:
        """From the sidecar of a checkpoint."""
        return cls(
            float(data["intercept"]),
            tuple(float(value) for value in data["coefficients"]),
            float(data["residual_ln_sd"]),
            tuple(data["names"]),
        )


def fit_volume_rule(features: NDArray[np.float64], weight_g: NDArray[np.float64]) -> VolumeRule:
    """Ridge-regularised least squares on logarithms, scaled so that the sum of predictions equals the sum of weights.

    Args:
        features: (n, 5) in the order of `NAMES`. weight_g: (n,).
    """
    logs = np.log(np.maximum(features, 1e-3))
    centre = logs.mean(0)
    target = np.log(weight_g)
    design = logs - centre
    normal = design.T @ design + 1e-3 * len(logs) * np.eye(design.shape[1]) * design.var(0).mean()
    coefficients = np.linalg.solve(normal, design.T @ (target - target.mean()))
    intercept = float(target.mean() - centre @ coefficients)
    rule = VolumeRule(intercept, tuple(float(value) for value in coefficients), 0.0)
    predicted = rule.weights_g(features)
    correction = float(np.log(weight_g.sum() / predicted.sum()))
    spread = float(np.std(target - np.log(predicted) - correction))
    return VolumeRule(intercept + correction, rule.coefficients, spread)


SHARES = np.round(np.arange(0.0, 0.51, 0.05), 2)
"""The network keeps at least half: the rule leans on one simulator's shapes more than the network does."""


def blend(network_g: NDArray[np.float64], volume_g: NDArray[np.float64], share: float) -> NDArray[np.float64]:
    """Weighted geometric mean of the network's and the volume rule's grams; share 0 is the network alone."""
    if share == 0.0:
        return network_g
    weight: NDArray[np.float64] = np.maximum(network_g, 1e-3) ** (1 - share) * volume_g**share
    return weight


def best_share(network_g: NDArray[np.float64], volume_g: NDArray[np.float64], weight_g: NDArray[np.float64]) -> float:
    """The share of the volume rule with the least mean absolute error on views neither was fitted on."""
    errors = [float(np.abs(blend(network_g, volume_g, float(share)) - weight_g).mean()) for share in SHARES]
    return float(SHARES[int(np.argmin(errors))])


TYPICAL_RULE = VolumeRule(np.log(0.85), (1.0, 0.0, 0.0, 0.0, 0.0), 0.2)
"""Before anything is fitted: weight is 0.85 g per ml of V_top."""
