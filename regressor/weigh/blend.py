"""Network and volume rule become one weight: by a share, and corrected for its size and for what rim is lost.

Whatever is fitted to noisy views leans towards the ordinary: it reads large tubers a little light and small ones heavy,
and those with much of the rim lost light. A load of large tubers, or a camera that loses rims, is then off as a whole.
So the correction is not the one that makes views most exact, but the one that leaves no bias over the *true* size and
rim: their true values are the instruments, what the view shows of them is what is corrected by.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError
from regressor.weigh.quadratic import FLAT, QuadraticRule
from regressor.weigh.rule_json import number, numbers
from regressor.weigh.view_features import VIEW_NAMES

SHARES = np.round(np.arange(0.0, 0.51, 0.05), 2)
"""The network keeps at least half. On worlds like those of the fit the rule alone is as good, but it leans on them
more: fitted without views of cameras that only round, both read those 8 % heavy, the network alone 4 %."""
SEEN = ("rim_lost",)
"""What is corrected for besides the weight: share of the silhouette that the camera lost. Pose was among it until rules
read how the surface falls (`profile`); since then tilted and standing tubers are right without."""
ROUNDS = 8
STRENGTH = 0.35
"""Of the correction by what is seen. It is made of estimates, so all of it makes single views worse; this much takes
away part of the bias over the rim and costs nothing (chosen on validation worlds)."""
MOST_CORRECTION = 0.2
"""Of ln weight: a view so strange that it asks for more is weighed as this much off and no more."""


@dataclass(frozen=True, slots=True)
class BlendRule:
    """ln weight = (1 - share) ln network + share ln rule + intercept + slope (that - middle) + slopes * what is seen.

    Attributes:
        share: of the volume rule.
        slope: over the blended ln weight less `middle`.
        slopes: over what `seen` finds, one each; `seen` has a rule for each of `SEEN`, or none.
    """

    share: float
    intercept: float = 0.0
    middle: float = 0.0
    slope: float = 0.0
    slopes: tuple[float, ...] = ()
    seen: tuple[QuadraticRule, ...] = ()

    def weights_g(
        self,
        network_g: NDArray[np.float64],
        volume_g: NDArray[np.float64],
        features: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """(n,) grams of n views: (n,) grams of both parts, (n, 37) features in the order of `VIEW_NAMES`."""
        mixed = blend(network_g, volume_g, self.share)
        if self == BlendRule(self.share):  # the same bits as before there was a correction
            return mixed
        ln_g = np.log(np.maximum(mixed, 1e-3))
        correction = self.intercept + self.slope * (ln_g - self.middle)
        for slope, rule in zip(self.slopes, self.seen, strict=True):
            correction = correction + slope * rule.values(features, known=VIEW_NAMES)
        weights: NDArray[np.float64] = np.exp(ln_g + np.clip(correction, -MOST_CORRECTION, MOST_CORRECTION))
        return weights

    def to_json(self) -> dict[str, Any]:
        """For the sidecar of a checkpoint."""
        return {
            "share": self.share,
            "intercept": self.intercept,
            "middle": self.middle,
            "slope": self.slope,
            "slopes": list(self.slopes),
            "seen": {name: rule.to_json() for name, rule in zip(SEEN, self.seen, strict=False)},
        }

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> BlendRule:
        """From the sidecar of a checkpoint.

        Raises:
            ValueError: it corrects for what this code does not know, or holds numbers that it cannot.
        """
        if tuple(data["seen"]) not in (SEEN, ()) or len(data["slopes"]) != len(data["seen"]):
            raise ValueError(f"a blend corrects for {list(data['seen'])}; known: {', '.join(SEEN)}")
        seen = tuple(QuadraticRule.from_json(rule) for rule in data["seen"].values())
        unknown = sorted({name for rule in seen for name in rule.names} - set(VIEW_NAMES))
        if unknown:
            raise ValueError(f"a blend reads {unknown}; known: {', '.join(VIEW_NAMES)}")
        share, intercept, middle, slope = (number(data, name) for name in ("share", "intercept", "middle", "slope"))
        return cls(share, intercept, middle, slope, numbers(data, "slopes"), seen)


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


def fit_blend(
    network_g: NDArray[np.float64],
    volume_g: NDArray[np.float64],
    weight_g: NDArray[np.float64],
    *,
    world: NDArray[np.str_] | None = None,
    found: NDArray[np.float64] | None = None,
    truth: NDArray[np.float64] | None = None,
    seen: tuple[QuadraticRule, ...] = (),
) -> BlendRule:
    """Share and correction from views that neither the network, nor the rule, nor what `found` is from was fitted on.

    Args:
        network_g, volume_g, weight_g: (n,) grams.
        world: (n,) name of the kind of world that each view is from. What a kind shares and no view shows (soil on
            tubers, say) is no matter of rim or pose: each has an intercept of its own in the fit, and the rule takes
            the middle of the highest and the lowest, so that none is off by more than half of what parts them.
        found: (n, k) of `SEEN` as views show it; truth: (n, k) as it is; seen: the rules that show it from now on.
            None corrects for the weight alone, and so does what is alike in all views of a world.

    Raises:
        InputError: the network's answers are nowhere near the truth.
    """
    share = best_share(network_g, volume_g, weight_g)
    ln_g, ln_truth = np.log(np.maximum(blend(network_g, volume_g, share), 1e-3)), np.log(weight_g)
    middle = float(ln_truth.mean())
    names, owner = np.unique(world if world is not None else np.zeros(len(ln_g)), return_inverse=True)
    own = np.eye(len(names))[owner]
    x, z = np.hstack([own, (ln_g - middle)[:, None]]), np.hstack([own, (ln_truth - middle)[:, None]])
    slopes = np.zeros(0)
    corrected = ln_g
    if found is not None and truth is not None:
        solved = STRENGTH * _solved(ln_g, weight_g, np.hstack([x, found]), np.hstack([z, truth]))[x.shape[1] :]
        if solved.any():
            slopes, corrected = solved, ln_g + found @ solved
    beta = _solved(corrected, weight_g, x, z)
    return BlendRule(
        share=share,
        intercept=float(beta[:-1].max() + beta[:-1].min()) / 2,
        middle=middle,
        slope=float(beta[-1]),
        slopes=tuple(slopes.tolist()),
        seen=seen if len(slopes) else (),
    )


def _solved(
    ln_g: NDArray[np.float64], weight_g: NDArray[np.float64], x: NDArray[np.float64], z: NDArray[np.float64]
) -> NDArray[np.float64]:
    """beta for which errors in grams of exp(ln_g + x beta) are uncorrelated with each column of z, by Newton steps.

    Totals are then right in every class of what z holds. Where a column of x or z says nothing, beta is 0.
    """
    telling = _telling(x, z)
    used, scaled = x[:, telling], z[:, telling] / np.abs(z[:, telling]).max(0)
    beta = np.zeros(used.shape[1])
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(ROUNDS):
            grams = np.exp(ln_g + used @ beta)
            if not np.isfinite(grams).all():
                factor = float(np.median(np.exp(ln_g) / weight_g))
                raise InputError(
                    f"no blend can be fitted: the network's answers are {factor:.3g} times the truth in the median. "
                    "Train it further, or begin with other weights"
                )
            beta = beta - np.linalg.solve(scaled.T @ (grams[:, None] * used), scaled.T @ (grams - weight_g))
    solved = np.zeros(x.shape[1])
    solved[telling] = beta
    return solved


def _telling(x: NDArray[np.float64], z: NDArray[np.float64]) -> list[int]:
    """Columns that in both vary beyond what those before them say: the rim that is lost alike everywhere tells nothing,
    and neither do weights that are all the same.
    """
    found: list[int] = []
    for at in range(x.shape[1]):
        if all(_rest(part[:, at], part[:, found]) > FLAT for part in (x, z)):
            found.append(at)
    return found


def _rest(column: NDArray[np.float64], others: NDArray[np.float64]) -> float:
    """Root mean square of what the others do not say of a column."""
    said = others @ np.linalg.lstsq(others, column, rcond=None)[0]
    return float(np.sqrt(np.mean(np.square(column - said))))
