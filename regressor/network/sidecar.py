"""What is known about weights beside their tensors: what they take, give and were made from."""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import replace
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from conveyor.errors import InputError
from regressor.network.architecture import NEIGHBOURS, RADIUS_1_M, RADIUS_2_M
from regressor.network.grouping import CLOUD_POINTS, stage_counts
from regressor.weigh.blend import BlendRule
from regressor.weigh.interval import IntervalRule
from regressor.weigh.volume import VolumeRule

FORMAT: Literal["tuberline-pointraft/1"] = "tuberline-pointraft/1"
NAME = r"^[^\x00-\x1f\x7f]{1,256}$"
"""What weights may be called: it stands in each message and in the ledger (`conveyor.ranges.Model`)."""
MOST_SHARED = (1.0, 0.2, 0.5)
"""Of what all tubers of a load share: own, per millimetre and other (`load_shares`). More is no scale."""


def checked_name(name: str) -> str:
    """`name`, where weights may be called so.

    Raises:
        InputError: they may not.
    """
    if not re.fullmatch(NAME, name):
        raise InputError(f"--name is {name!r}: allowed are 1 to 256 characters, and none that does not print")
    return name


def unit_of(target: str) -> str:
    """Of what a network gives: 'g', 'ml' or 'mm'."""
    return target.rpartition("_")[2]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class InputSpec(_Part):
    """What the network takes. Fixed by the architecture; written down so that no one has to guess.

    Numbers that are not those of this program's networks are refused: tensors do not show them.
    """

    points: int = Field(CLOUD_POINTS, ge=64, le=8192)
    frame: str = "level: z away from the camera along the belt's normal, metres, centred on the mean of all points"
    order: str = "farthest-point sampling in selection order, lowest index on ties"
    height: str = "clamp(belt distance - min z, 0, max_height_m) metres, before centring"
    max_height_m: float = Field(0.08, gt=0)
    radii_m: tuple[float, float] = (RADIUS_1_M, RADIUS_2_M)
    neighbours: int = NEIGHBOURS
    neighbour_rule: str = "first 64 in index order with squared distance < radius squared"
    centroids: tuple[int, int] = stage_counts(CLOUD_POINTS)
    height_embedding: bool = True

    @model_validator(mode="after")
    def _as_built(self) -> Self:
        built = {
            "radii_m": (RADIUS_1_M, RADIUS_2_M),
            "neighbours": NEIGHBOURS,
            "centroids": stage_counts(self.points),
        }
        for name, value in built.items():
            if getattr(self, name) != value:
                raise ValueError(
                    f"{name} is {getattr(self, name)}, and this program's networks have {value}: weights of another "
                    "network would weigh wrong"
                )
        return self


class StartPolicy(_Part):
    """First pick of each sampling: 'prefix' always the cloud's first point; 'random' as drawn from `seed`."""

    kind: Literal["prefix", "random"] = "prefix"
    seed: int = 0


class Range(_Part):
    """What the training saw, inclusive."""

    low: float
    high: float

    def holds(self, value: float) -> bool:
        """Whether `value` lies inside."""
        return self.low <= value <= self.high


class Sidecar(_Part):
    """All that is known about a checkpoint beside its tensors."""

    format: Literal["tuberline-pointraft/1"] = FORMAT
    name: str = Field(pattern=NAME)
    sha256: str = ""
    target: Literal["weight_g", "volume_ml", "length_mm"] = "weight_g"
    network: Literal["pointraft", "pointnet"] = "pointraft"
    input: InputSpec = InputSpec()
    start: StartPolicy = StartPolicy()
    belt_distance_m: Range = Range(low=0.25, high=0.6)
    weight_g: Range = Range(low=10.0, high=700.0)
    length_mm: Range = Range(low=25.0, high=180.0)
    volume_share: float = Field(0.0, ge=0, lt=1)
    disagreement_factor: float = Field(1.6, gt=1)
    shared_sd_share: float = Field(0.9, ge=0, le=1)
    shared_bias_share: float = Field(0.05, ge=0, le=MOST_SHARED[0])
    interval: dict[str, Any] | None = None
    volume_rule: dict[str, Any] | None = None
    blend: dict[str, Any] | None = None
    shared_level_share_per_mm: float = Field(0.0, ge=0, le=MOST_SHARED[1])
    shared_other_share: float = Field(0.0, ge=0, le=MOST_SHARED[2])
    worlds: tuple[str, ...] = ()
    training: dict[str, Any] = Field(default_factory=dict)
    metrics: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _rules_as_known(self) -> Self:
        rules = {"interval": "interval_rule", "volume_rule": "fitted_volume_rule", "blend": "blend_rule"}
        for name, rule in rules.items():
            try:
                getattr(self, rule)
            except (KeyError, TypeError, AttributeError, ValueError) as error:
                why = f"{error} is missing" if isinstance(error, KeyError) else str(error)
                raise ValueError(f"its {name} is damaged or of another version of this program: {why}") from error
        return self

    @property
    def unit(self) -> str:
        """Of the target, where code and tables say g."""
        return unit_of(self.target)

    @property
    def interval_rule(self) -> IntervalRule | None:
        """The calibrated interval, if there is one; calibrated as far away as trained where it does not say."""
        if not self.interval:
            return None
        rule = IntervalRule.from_json(self.interval)
        return rule if rule.farthest_m is not None else replace(rule, farthest_m=self.belt_distance_m.high)

    @property
    def calibrated_belt_m(self) -> Range:
        """Camera to belt: what the training saw and, of that, no farther away than intervals were calibrated."""
        trained, rule = self.belt_distance_m, self.interval_rule
        farthest_m = trained.high if rule is None or rule.farthest_m is None else rule.farthest_m
        return Range(low=trained.low, high=max(trained.low, min(trained.high, farthest_m)))

    @property
    def fitted_volume_rule(self) -> VolumeRule | None:
        """The volume rule fitted with these weights, if there is one."""
        return VolumeRule.from_json(self.volume_rule) if self.volume_rule else None

    @property
    def blend_rule(self) -> BlendRule:
        """How network and volume rule become one weight; by the share alone where nothing more was fitted."""
        return BlendRule.from_json(self.blend) if self.blend else BlendRule(self.volume_share)

    @property
    def model_id(self) -> str:
        """Name and the first eight digits of a hash, as it stands in the ledger: of all that makes a weight.

        The tensors' own hash; with a blend of its own, together with rule, blend and intervals.
        """
        if self.blend is None:
            return f"{self.name}@{self.sha256[:8]}"
        rules = json.dumps([self.sha256, self.volume_rule, self.blend, self.interval], sort_keys=True)
        return f"{self.name}@{hashlib.sha256(rules.encode()).hexdigest()[:8]}"
