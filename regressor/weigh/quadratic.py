"""A number that is quadratic in what a surface measures: the volume rule's form, and of what a view shows of itself."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from regressor.weigh.surface import NAMES

UNITS = ("_ml", "_cm2", "_mm")
RIDGE = 3e-3
CLIP_SHARE = 0.001


def terms_of(
    features: NDArray[np.float64], names: tuple[str, ...], *, known: tuple[str, ...] = NAMES
) -> NDArray[np.float64]:
    """(n, k) of (n, m) features as in `known`: the logarithm of a feature with a unit, the feature itself else."""
    columns = [features[:, known.index(name)] for name in names]
    logs = [np.log(np.maximum(c, 1e-3)) if n.endswith(UNITS) else c for n, c in zip(names, columns, strict=True)]
    return np.column_stack(logs)


def pairs_of(terms: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, k (k + 1) / 2) products of all pairs of terms, clipped to low..high and scaled to -1..1."""
    scaled = 2 * (np.clip(terms, low, high) - low) / np.maximum(high - low, 1e-9) - 1
    first, second = np.triu_indices(terms.shape[1])
    return scaled[:, first] * scaled[:, second]


def ranges_of(terms: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(low, high) of each term, without the outermost thousandth."""
    low, high = np.quantile(terms, [CLIP_SHARE, 1 - CLIP_SHARE], axis=0)
    return low, high


@dataclass(frozen=True, slots=True)
class QuadraticRule:
    """intercept + sum(coefficients * terms) + sum(products * pairs of terms), over all features.

    All terms are clipped to `low`..`high`, what the fit saw, and the value to `least`..`most`. `names`: the features.
    """

    intercept: float
    coefficients: tuple[float, ...]
    products: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    least: float
    most: float
    names: tuple[str, ...] = NAMES

    def values(self, features: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) of (n, k) features in the order of `names`."""
        low, high = np.array(self.low), np.array(self.high)
        terms = np.clip(terms_of(features, self.names, known=self.names), low, high)
        found = self.intercept + terms @ np.array(self.coefficients)
        found = found + pairs_of(terms, low, high) @ np.array(self.products)
        clipped: NDArray[np.float64] = np.clip(found, self.least, self.most)
        return clipped

    def to_json(self) -> dict[str, Any]:
        """For the sidecar of a checkpoint; names only where they are not those of every surface."""
        return {name: value for name, value in asdict(self).items() if name != "names" or self.names != NAMES}

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> QuadraticRule:
        """From the sidecar of a checkpoint."""
        lists = {name: tuple(float(v) for v in data[name]) for name in ("coefficients", "products", "low", "high")}
        names = tuple(str(name) for name in data.get("names", NAMES))
        least, most = float(data["least"]), float(data["most"])
        return cls(intercept=float(data["intercept"]), least=least, most=most, names=names, **lists)


def fit_quadratic(
    features: NDArray[np.float64], target: NDArray[np.float64], *, names: tuple[str, ...] = NAMES
) -> QuadraticRule:
    """Ridge-regularised least squares of (n,) targets on (n, k) features in the order of `names`."""
    terms = terms_of(features, names, known=names)
    low, high = ranges_of(terms)
    terms = np.clip(terms, low, high)
    columns = np.column_stack([terms, pairs_of(terms, low, high)])
    centre, spread = columns.mean(0), np.maximum(columns.std(0), 1e-9)
    design = (columns - centre) / spread
    normal = design.T @ design + RIDGE * len(design) * np.eye(design.shape[1])
    slopes = np.linalg.solve(normal, design.T @ (target - target.mean())) / spread
    least, most = np.quantile(target, [CLIP_SHARE, 1 - CLIP_SHARE])
    return QuadraticRule(
        intercept=float(target.mean() - centre @ slopes),
        coefficients=tuple(slopes[: len(names)].tolist()),
        products=tuple(slopes[len(names) :].tolist()),
        low=tuple(low.tolist()),
        high=tuple(high.tolist()),
        least=float(least),
        most=float(most),
        names=names,
    )
