"""Network and volume rule become one weight: by a share, and by what the view shows of pose, rim and size.

Both read the same surface and err differently: the network knows shapes, the rule knows how much of the rim is lost and
how the tuber lies. What bias is left in a class of pose or rim after the share is taken is linear in a few features.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from regressor.weigh.surface import NAMES

SHARES = np.round(np.arange(0.0, 0.51, 0.05), 2)
"""The network keeps at least half: the rule leans on one simulator's shapes more than the network does."""
TERMS = ("ln_weight", "ln_weight_squared", "steepness", "rim", "rim_low", "tilt", "holes", "bites", "flatness")
TYPICAL_G = 150.0
RIDGE = 0.02
ROUNDS = 30
MOST_CORRECTION = 0.15
"""Of ln weight: a view so strange that it asks for more is weighed as this much off and no more."""


@dataclass(frozen=True, slots=True)
class BlendRule:
    """ln weight = (1 - share) ln network + share ln rule + a correction linear in `TERMS`, stretched about `middle`.

    Attributes:
        share: of the volume rule.
        intercept, slopes: of the correction; low, high: terms are clipped to what the fit saw.
        stretch: factor of the distance of ln weight from `middle`. What is fitted to noisy views reads large tubers a
            little light and small ones a little heavy; loads of large or of small tubers would then be off.
    """

    share: float
    intercept: float
    slopes: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    middle: float
    stretch: float

    @classmethod
    def of_share(cls, share: float) -> BlendRule:
        """The share alone, without correction."""
        none = (0.0,) * len(TERMS)
        return cls(share=share, intercept=0.0, slopes=none, low=none, high=none, middle=0.0, stretch=1.0)

    def weights_g(
        self,
        network_g: NDArray[np.float64],
        volume_g: NDArray[np.float64],
        features: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """(n,) grams of n views: (n,) grams of both parts, (n, 17) features in the order of `surface.NAMES`."""
        mixed = blend(network_g, volume_g, self.share)
        if self == BlendRule.of_share(self.share):  # the same bits as before there was a correction
            return mixed
        terms = np.clip(blend_terms(mixed, features), self.low, self.high)
        ln_g = np.log(mixed) + np.clip(
            self.intercept + terms @ np.array(self.slopes), -MOST_CORRECTION, MOST_CORRECTION
        )
        weights: NDArray[np.float64] = np.exp(self.middle + self.stretch * (ln_g - self.middle))
        return weights

    def to_json(self) -> dict[str, Any]:
        """For the sidecar of a checkpoint."""
        return {"terms": TERMS, **asdict(self)}

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> BlendRule:
        """From the sidecar of a checkpoint.

        Raises:
            ValueError: made from other terms than this code knows.
        """
        if tuple(data["terms"]) != TERMS:
            raise ValueError(f"a blend is made from {data['terms']}; known: {TERMS}")
        slopes, low, high = (tuple(float(value) for value in data[name]) for name in ("slopes", "low", "high"))
        share, intercept, middle, stretch = (float(data[n]) for n in ("share", "intercept", "middle", "stretch"))
        return cls(share, intercept, slopes, low, high, middle, stretch)


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


def blend_terms(weight_g: NDArray[np.float64], features: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 9) in the order of `TERMS`: of (n,) grams and (n, 17) features as in `surface.NAMES`."""
    values = {name: features[:, at] for at, name in enumerate(NAMES)}
    ln_weight = np.log(np.maximum(weight_g, 1.0) / TYPICAL_G)
    area, hull = np.maximum(values["area_cm2"], 0.1), np.maximum(values["hull_cm2"], 0.1)
    return np.column_stack(
        [
            ln_weight,
            ln_weight**2,
            np.log(np.maximum(values["height_mm"], 5.0) / np.maximum(values["width_mm"], 5.0)),
            values["rim"],
            values["rim_low"],
            values["tilt"],
            values["hole_share"],
            np.log(hull / area),
            np.log(np.maximum(values["curvature_cm2"], 0.1) / area),
        ]
    )


def fit_blend(
    network_g: NDArray[np.float64],
    volume_g: NDArray[np.float64],
    features: NDArray[np.float64],
    weight_g: NDArray[np.float64],
) -> BlendRule:
    """Share, correction and stretch from views that neither the network nor the rule was fitted on.

    The correction is a ridge gamma regression of truth over blend; then the stretch lets ln weight follow the truth's
    logarithm with slope 1, and the total stays what it is.

    Args:
        network_g, volume_g, weight_g: (n,). features: (n, 17).
    """
    share = best_share(network_g, volume_g, weight_g)
    mixed = blend(network_g, volume_g, share)
    terms = blend_terms(mixed, features)
    low, high = np.quantile(terms, [0.005, 0.995], axis=0)
    terms = np.clip(terms, low, high)
    centre, spread = terms.mean(0), np.maximum(terms.std(0), 1e-9)
    design = np.column_stack([np.ones(len(terms)), (terms - centre) / spread])
    penalty = RIDGE * len(terms) * np.diag([0.0] + [1.0] * len(TERMS))
    normal = design.T @ design + penalty
    beta = np.zeros(design.shape[1])
    for _ in range(ROUNDS):
        ratio = np.minimum(weight_g / (mixed * np.exp(design @ beta)), 3.0)
        step = np.linalg.solve(normal, design.T @ (ratio - 1) - penalty @ beta)
        beta = beta + step
        if float(np.abs(step).max()) < 1e-10:
            break
    slopes = beta[1:] / spread
    intercept = float(beta[0] - centre @ slopes)
    ln_g, truth = np.log(mixed) + design @ beta, np.log(weight_g)
    middle = float(truth.mean())
    stretch = float(1 / np.polyfit(truth, ln_g, 1)[0])
    stretched = np.exp(middle + stretch * (ln_g - middle))
    # The total stays right: the stretch alone would raise the large more than it lowers the small.
    intercept += float(np.log(weight_g.sum() / stretched.sum())) / stretch
    return BlendRule(
        share=share,
        intercept=intercept,
        slopes=tuple(slopes.tolist()),
        low=tuple(low.tolist()),
        high=tuple(high.tolist()),
        middle=middle,
        stretch=stretch,
    )
