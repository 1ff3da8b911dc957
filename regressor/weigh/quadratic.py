"""A number that is quadratic in what a surface measures: the volume rule's form, and of what a view shows of itself."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel
from regressor.weigh.rule_json import number, numbers
from regressor.weigh.surface import FIRST_NAMES
from regressor.weigh.view_features import VIEW_NAMES

UNITS = ("_ml", "_cm2", "_mm", "_px")
RIDGE = 3e-3
CLIP_SHARE = 0.001
FLAT = 1e-6
"""Standard deviation of a column below which it says nothing: its slope is none."""


def terms_of(
    features: NDArray[np.float64], names: tuple[str, ...], *, known: tuple[str, ...] = VIEW_NAMES
) -> NDArray[np.float64]:
    """(n, k) of (n, m) features as in `known`: the logarithm of a feature with a unit, the feature itself else."""
    columns, with_unit = _columns(names, known)
    terms: NDArray[np.float64] = features[:, columns].astype(np.float64)
    terms[:, with_unit] = np.log(np.maximum(terms[:, with_unit], 1e-3))
    return terms


@lru_cache
def _columns(names: tuple[str, ...], known: tuple[str, ...]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Where `names` stand in `known`, and which of them have a unit."""
    with_unit = [at for at, name in enumerate(names) if name.endswith(UNITS)]
    return np.array([known.index(name) for name in names]), np.array(with_unit, np.int64)


@lru_cache
def _pairs(count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and second of all pairs of so many terms."""
    first, second = np.triu_indices(count)
    return first, second


def within(values: NDArray[np.float64], low: Any, high: Any) -> NDArray[np.float64]:
    """Values clipped to low..high: as `np.clip`, without what that does around it."""
    clipped: NDArray[np.float64] = np.minimum(np.maximum(values, low), high)
    return clipped


def pairs_of(terms: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, k (k + 1) / 2) products of all pairs of terms, clipped to low..high and scaled to -1..1."""
    scaled = 2 * (within(terms, low, high) - low) / np.maximum(high - low, 1e-9) - 1
    first, second = _pairs(terms.shape[1])
    return scaled[:, first] * scaled[:, second]


@kernel(nogil=True)
def quadratic(
    terms: NDArray[np.float64],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    coefficients: NDArray[np.float64],
    products: NDArray[np.float64],
) -> NDArray[np.float64]:
    """(n,) of (n, k) terms: the sum of coefficients times terms, and of products times `pairs_of` the terms."""
    rows, count = terms.shape
    found, scaled = np.empty(rows), np.empty(count)
    for row in range(rows):
        total = 0.0
        for i in range(count):
            term = terms[row, i]
            total += coefficients[i] * term
            scaled[i] = 2 * (min(max(term, low[i]), high[i]) - low[i]) / max(high[i] - low[i], 1e-9) - 1
        at = 0
        for i in range(count):
            part = 0.0
            for j in range(i, count):
                part += products[at] * scaled[j]
                at += 1
            total += part * scaled[i]
        found[row] = total
    return found


def ranges_of(terms: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(low, high) of each term, without the outermost thousandth."""
    low, high = np.quantile(terms, [CLIP_SHARE, 1 - CLIP_SHARE], axis=0)
    return low, high


def spreads_of(columns: NDArray[np.float64]) -> NDArray[np.float64]:
    """(k,) standard deviation of (n, k) columns; infinite where a column is the same everywhere."""
    spread = columns.std(0)
    spreads: NDArray[np.float64] = np.where(spread > FLAT, spread, np.inf)
    return spreads


@dataclass(frozen=True)
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
    names: tuple[str, ...] = FIRST_NAMES

    def values(self, features: NDArray[np.float64], *, known: tuple[str, ...] | None = None) -> NDArray[np.float64]:
        """(n,) of (n, k) features in the order of `known`, which is that of `names` where it is not given."""
        return self.of_terms(self.terms(features, known=known))

    def terms(self, features: NDArray[np.float64], *, known: tuple[str, ...] | None = None) -> NDArray[np.float64]:
        """(n, t) clipped terms of (n, k) features: the same for rules `alike`."""
        low, high, _, _ = self._arrays
        return within(terms_of(features, self.names, known=known or self.names), low, high)

    def of_terms(self, terms: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) of what `terms` gives."""
        return within(self.intercept + quadratic(terms, *self._arrays), self.least, self.most)

    @cached_property
    def _arrays(self) -> tuple[NDArray[np.float64], ...]:
        """As `quadratic` takes them."""
        return tuple(np.array(values) for values in (self.low, self.high, self.coefficients, self.products))

    def alike(self, other: QuadraticRule) -> bool:
        """Both have the same terms of the same features."""
        return (self.names, self.low, self.high) == (other.names, other.low, other.high)

    def to_json(self) -> dict[str, Any]:
        """For the sidecar of a checkpoint; names only where they are not the first."""
        return {name: value for name, value in asdict(self).items() if name != "names" or self.names != FIRST_NAMES}

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> QuadraticRule:
        """From the sidecar of a checkpoint.

        Raises:
            ValueError: it holds numbers that it cannot.
        """
        names = tuple(str(name) for name in data.get("names", FIRST_NAMES))
        many = len(names)
        return cls(
            number(data, "intercept"),
            numbers(data, "coefficients", many),
            numbers(data, "products", many * (many + 1) // 2),
            numbers(data, "low", many),
            numbers(data, "high", many),
            number(data, "least"),
            number(data, "most"),
            names,
        )


def fit_quadratic(
    features: NDArray[np.float64],
    target: NDArray[np.float64],
    *,
    names: tuple[str, ...] = FIRST_NAMES,
    weights: NDArray[np.float64] | None = None,
) -> QuadraticRule:
    """Ridge-regularised least squares of (n,) targets on (n, k) features in the order of `names`.

    `weights`: (n,) of the rows; default: all alike.
    """
    terms = terms_of(features, names, known=names)
    low, high = ranges_of(terms)
    terms = np.clip(terms, low, high)
    columns = np.column_stack([terms, pairs_of(terms, low, high)])
    share = np.full(len(target), 1 / len(target)) if weights is None else weights / weights.sum()
    centre, spread = share @ columns, spreads_of(columns)
    design = (columns - centre) / spread
    weighted = design.T * share
    normal = weighted @ design + RIDGE * np.eye(design.shape[1])
    middle = float(share @ target)
    slopes = np.linalg.solve(normal, weighted @ (target - middle)) / spread
    least, most = np.quantile(target, [CLIP_SHARE, 1 - CLIP_SHARE])
    return QuadraticRule(
        intercept=float(middle - centre @ slopes),
        coefficients=tuple(slopes[: len(names)].tolist()),
        products=tuple(slopes[len(names) :].tolist()),
        low=tuple(low.tolist()),
        high=tuple(high.tolist()),
        least=float(least),
        most=float(most),
        names=names,
    )
