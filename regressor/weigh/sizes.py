"""Length, width, thickness and square-mesh size of a tuber from what one view's surface measures.

A square hole is passed lengthwise, so its side is decided by the cross section: an ellipse W x T passes, turned by 45
degrees, a square of side sqrt((W^2 + T^2) / 2), and a fuller section up to 7 % more. Of that section a camera sees the
outline's width and the height; which of the axes they are depends on how the tuber lies, and how much of the outline is
lost on the camera. So each size is a quadratic rule in the surface's features and in the sizes of the body completed by
mirroring (`completed`), fitted on simulated belts (docs/sizes.md); how far off it may be follows from what the view
shows of itself.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError
from conveyor.messages.sizes import MEASURES, Sizes
from conveyor.statistics import NORMAL_90
from regressor.weigh import completed, surface
from regressor.weigh.prepare import PreparedCloud
from regressor.weigh.quadratic import QuadraticRule, fit_quadratic
from regressor.weigh.viewscale import ScaleRule, beyond, fit_scale

SHIPPED = Path(__file__).parents[1] / "weights" / "tuberline-sizes.json"
FORMAT = "tuberline-sizes/1"
FEATURES = (*surface.FIRST_NAMES, *completed.NAMES)
"""What the rules read."""
FARTHER = 0.8
"""Beyond the belts of the fit standard deviations grow by this power of the distance: a pixel shows more of a tuber,
and depth is coarser. Chosen on view packs of seed 8111 and judged on those of 8222 (docs/sizes.md)."""


@dataclass(frozen=True, slots=True)
class SizeRule:
    """One size: ln mm = `value`, and its standard deviation = `spread` times the scale that the view suggests."""

    value: QuadraticRule
    scale: ScaleRule
    spread: float

    def sizes_mm(
        self, features: NDArray[np.float64], terms: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(n,) millimetres and their (n,) standard deviations, of (n, 21) features and (n, 6) `view_terms`."""
        return self.of_terms(self.value.terms(features), terms)

    def of_terms(
        self, value_terms: NDArray[np.float64], terms: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The same of what `value.terms` gives."""
        return np.exp(self.value.of_terms(value_terms)), self.spread * self.scale.scale_g(terms)


@dataclass(frozen=True, slots=True)
class SizeRules:
    """The rules of all four sizes, by name, in the order of `MEASURES`.

    `farthest_m`: distance to the belt of the farthest views of the fit; None where it was not noted.
    """

    rules: dict[str, SizeRule]
    farthest_m: float | None = None

    def sizes(self, features: NDArray[np.float64], terms: NDArray[np.float64], *, distance_m: float) -> Sizes:
        """Of one view: its (21,) features, (6,) `view_terms` and distance to the belt. Axes come out sorted."""
        found, before, value_terms = {}, None, None
        wider = float(beyond(distance_m, self.farthest_m, FARTHER))
        for name, rule in self.rules.items():
            if value_terms is None or before is None or not rule.value.alike(before):
                before, value_terms = rule.value, rule.value.terms(features[None])
            found[name] = rule.of_terms(value_terms, terms[None])
        values = {name: float(value[0]) for name, (value, _) in found.items()}
        values["width"] = min(values["width"], values["length"])
        values["thickness"] = min(values["thickness"], values["width"])
        said = {f"{name}_mm": round(value, 2) for name, value in values.items()}
        return Sizes(**said, **{f"{name}_sd_mm": round(wider * float(sd[0]), 3) for name, (_, sd) in found.items()})

    def to_json(self) -> dict[str, Any]:
        """For the file of rules."""
        rules = {
            name: {"value": rule.value.to_json(), "scale": rule.scale.to_json(), "spread": rule.spread}
            for name, rule in self.rules.items()
        }
        farthest = {} if self.farthest_m is None else {"farthest_m": self.farthest_m}
        return {"format": FORMAT, **farthest, "rules": rules}

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> SizeRules:
        """From the file of rules.

        Raises:
            ValueError, KeyError, TypeError: it is none.
        """
        if data["format"] != FORMAT or tuple(data["rules"]) != MEASURES:
            raise ValueError(f"format {data['format']!r} of {list(data['rules'])}; known: {FORMAT!r} of {MEASURES}")
        return cls(
            {
                name: SizeRule(
                    QuadraticRule.from_json(rule["value"]), ScaleRule.from_json(rule["scale"]), float(rule["spread"])
                )
                for name, rule in data["rules"].items()
            },
            float(data["farthest_m"]) if "farthest_m" in data else None,
        )


@lru_cache(maxsize=4)
def load_rules(path: Path = SHIPPED) -> SizeRules:
    """The rules of a file, or the shipped ones.

    Raises:
        InputError: it cannot be read.
    """
    try:
        return SizeRules.from_json(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"rules of sizes {path} cannot be read: {error}") from error


def fit_sizes(
    features: NDArray[np.float64],
    sizes_mm: NDArray[np.float64],
    terms: NDArray[np.float64],
    weights: NDArray[np.float64] | None = None,
    *,
    farthest_m: float | None = None,
) -> SizeRules:
    """The rules from views with their truth.

    Args:
        features: (n, 21) in the order of `FEATURES`. sizes_mm: (n, 4) in the order of `MEASURES`.
        terms: (n, 6) of `view_terms`. weights: (n,) of the views in the sizes; default: all alike.
        farthest_m: distance to the belt of the farthest of these views.
    """
    rules = {}
    for column, name in enumerate(MEASURES):
        value = fit_quadratic(features, np.log(sizes_mm[:, column]), names=FEATURES, weights=weights)
        residual_mm = sizes_mm[:, column] - np.exp(value.values(features))
        scale = fit_scale(terms, residual_mm)
        spread = float(np.quantile(np.abs(residual_mm) / scale.scale_g(terms), 0.9)) / NORMAL_90
        rules[name] = SizeRule(value, scale, spread)
    return SizeRules(rules, farthest_m)


def size_features(cloud: PreparedCloud) -> NDArray[np.float64]:
    """(21,) features of a prepared cloud, in the order of `FEATURES`."""
    level = cloud.points.astype(np.float64) + np.array(cloud.centre_m)
    distance_m = cloud.belt_distance_m + cloud.resting_offset_m
    sizes = completed.completed_sizes_mm(level, distance_m=distance_m, height_m=cloud.height_m)
    return np.array([*cloud.surface.as_array()[: len(surface.FIRST_NAMES)], *sizes])
