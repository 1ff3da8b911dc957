"""What a patch says of its track, and how noisy the patch is that says it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from segmenter.classify.patch import Patch

# Tuned with the constants of `prior`, on the same tracks; in brackets the same three numbers, 0, 8, 16 as it is.
TRAINED_ERROR_MM = 0.6
"""Standard error of the averaged heights up to which the network's answer is taken as it is: tubers under cameras of
`easy` and `field` have 0.25 to 0.55 mm, under local noise of 0.12 px 0.55 to 0.85. Less: poor cameras refuse less
(0.45: 0, 6, 29; 0.75: 0, 12, 15)."""
FADING = 0.5
"""Power of the error's ratio to that by which an answer shrinks: 0 would shrink none (1, 13, 15), 1 all the more (0, 5,
33)."""
SURE = 0.8
"""Share of a cell that must be the instance's to be measured: the rim's spread is the rim's, not the camera's."""


@dataclass(frozen=True, slots=True)
class PatchNoise:
    """How noisy a patch is, inside its instance.

    Attributes:
        spread_mm: median over its cells of the standard deviation from observation to observation.
        error_mm: median standard error of the averaged heights.
        hole_share: share of cells times observations without depth.
        observations: how many were averaged.
    """

    spread_mm: float
    error_mm: float
    hole_share: float
    observations: int


@dataclass(frozen=True, slots=True)
class Evidence:
    """The network's answer for a patch: how much likelier it is for a tuber than for a clod, as a natural logarithm."""

    log_odds: float
    noise: PatchNoise


@dataclass(frozen=True, slots=True)
class Answer:
    """What is believed of a track: log-odds of tuber against other on this belt, and the evidence of its patch."""

    log_odds: float
    evidence: Evidence


def tempered(evidence: Evidence) -> float:
    """The network's log-odds, shrunk towards none where the patch is noisier than those it learned from.

    Holes and few observations are in it: they leave a larger error.
    """
    error_mm = evidence.noise.error_mm
    return (
        evidence.log_odds
        if error_mm <= TRAINED_ERROR_MM
        else evidence.log_odds * (TRAINED_ERROR_MM / error_mm) ** FADING
    )


def noise_of(patch: Patch) -> PatchNoise:
    """How noisy a patch of at least one observation is."""
    spread_mm, count, inside = patch.spread()
    sure = inside > SURE
    if not sure.any():
        return PatchNoise(0.0, 0.0, 1.0, patch.observations)
    return PatchNoise(
        spread_mm=float(np.median(spread_mm[sure])),
        error_mm=float(np.median(spread_mm[sure] / np.sqrt(count[sure]))),
        hole_share=float(1 - count[sure].mean() / patch.observations),
        observations=patch.observations,
    )
