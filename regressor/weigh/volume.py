"""A weight from what the visible surface measures: the fallback when no network fits, and its check.

`V_top = sum((H - z) * area of the pixel at depth z)` is the volume between the visible surface and the resting level.
With the outline, cross sections, the rim's height and how the tuber lies it predicts weight far better than the
paper's box does (docs/pointraft.md).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from regressor.weigh.quadratic import RIDGE, UNITS, pairs_of, quadratic, ranges_of, spreads_of, terms_of, within
from regressor.weigh.rule_json import number, numbers
from regressor.weigh.view_features import VIEW_NAMES

FIRST_NAMES = ("volume_ml", "area_cm2", "length_mm", "width_mm", "height_mm")
"""What a rule from before the other features reads."""
ROUNDS = 30
MOST_OFF = 3.0
BEYOND = 1.0
"""How far a term without a unit may lie outside of what the fit saw, in widths of that, before it is held there. A
share of holes a hundred times that of the fit was read as 960 times a weight. Sizes are not held: larger tubers are
read well a good way on, and what is absurdly large must be seen to be. Of 8,000 views of all presets none lies that far
outside of what the shipped rule saw."""


@dataclass(frozen=True)
class VolumeRule:
    """ln weight = intercept + sum(coefficients * terms) + sum(products * pairs of standardised terms).

    A term is the logarithm of a feature with a unit, and the feature itself where it has none.

    Attributes:
        coefficients: one per name. residual_ln_sd: of ln weight, on what it was fitted on.
        low, high: of each term in the fit; products take terms clipped to it and scaled to -1..1, so that what was
            never seen is not extrapolated quadratically. Terms without a unit are clipped `BEYOND` it. Empty: unknown.
        products: of the pairs (i, j), i <= j, row by row; empty without them.
    """

    intercept: float
    coefficients: tuple[float, ...]
    residual_ln_sd: float
    names: tuple[str, ...] = FIRST_NAMES
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()
    products: tuple[float, ...] = ()

    def weights_g(self, features: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) grams of (n, 37) features in the order of `VIEW_NAMES`."""
        low, high, coefficients, products = self._arrays
        terms = terms_of(features, self.names)
        if self.low:
            terms = within(terms, *self._limits)
        found = quadratic(terms, low, high, coefficients, products) if self.products else terms @ coefficients
        weights: NDArray[np.float64] = np.exp(within(self.intercept + found, -5.0, 12.0))
        return weights

    @cached_property
    def _arrays(self) -> tuple[NDArray[np.float64], ...]:
        """As `quadratic` takes them."""
        return tuple(np.array(values) for values in (self.low, self.high, self.coefficients, self.products))

    @cached_property
    def _limits(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return limits_of(self)

    def to_json(self) -> dict[str, Any]:
        """For the sidecar of a checkpoint."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> VolumeRule:
        """From the sidecar of a checkpoint.

        Raises:
            ValueError: it reads features that this code does not know, or holds numbers that it cannot.
        """
        names = tuple(data["names"])
        unknown = sorted(set(names) - set(VIEW_NAMES))
        if unknown:
            raise ValueError(f"a volume rule reads {unknown}; known: {', '.join(VIEW_NAMES)}")
        many = len(names)
        known = any(data.get(key) for key in ("low", "high", "products"))
        low, high = (numbers(data, key, many) if known else () for key in ("low", "high"))
        return cls(
            number(data, "intercept"),
            numbers(data, "coefficients", many),
            number(data, "residual_ln_sd"),
            names,
            low,
            high,
            numbers(data, "products", many * (many + 1) // 2) if data.get("products") else (),
        )


def limits_of(rule: VolumeRule) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What a rule's terms are clipped to, each (k,): `BEYOND` widths of low..high outside of it, for those without a
    unit.
    """
    margin = np.where([name.endswith(UNITS) for name in rule.names], np.inf, BEYOND * np.subtract(rule.high, rule.low))
    return np.subtract(rule.low, margin), np.add(rule.high, margin)


def fit_volume_rule(
    features: NDArray[np.float64],
    weight_g: NDArray[np.float64],
    *,
    names: tuple[str, ...] = VIEW_NAMES,
    squares: bool = True,
) -> VolumeRule:
    """Ridge-regularised gamma regression with a log link.

    Its relative errors are uncorrelated with every term: no bias over size, pose or rim as far as the terms show them.

    Args:
        features: (n, 37) in the order of `VIEW_NAMES`. weight_g: (n,). squares: with products of terms.
    """
    terms = terms_of(features, names)
    low, high = ranges_of(terms)
    columns = np.column_stack([terms, pairs_of(terms, low, high)]) if squares else terms
    centre, spread = columns.mean(0), spreads_of(columns)
    design = np.column_stack([np.ones(len(columns)), (columns - centre) / spread])
    penalty = RIDGE * len(columns) * np.diag([0.0] + [1.0] * columns.shape[1])
    normal = design.T @ design + penalty
    beta = np.linalg.solve(normal, design.T @ np.log(weight_g))
    for _ in range(ROUNDS):
        ratio = np.minimum(weight_g / np.exp(design @ beta), MOST_OFF)
        step = np.linalg.solve(normal, design.T @ (ratio - 1) - penalty @ beta)
        beta = beta + step
        if float(np.abs(step).max()) < 1e-9:
            break
    slopes = beta[1:] / spread
    count = terms.shape[1]
    return VolumeRule(
        float(beta[0] - centre @ slopes),
        tuple(slopes[:count].tolist()),
        float(np.std(np.log(weight_g) - design @ beta)),
        names,
        tuple(low.tolist()) if squares else (),
        tuple(high.tolist()) if squares else (),
        tuple(slopes[count:].tolist()),
    )


TYPICAL_RULE = VolumeRule(np.log(0.85), (1.0, 0.0, 0.0, 0.0, 0.0), 0.2)
"""Before anything is fitted: weight is 0.85 g per ml of V_top."""
