"""What a patch says of its track, and how noisy the patch is that says it."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import fmean

import numpy as np

from segmenter.classify.patch import Patch

# Tuned with the constants of `prior` on the same tracks; in brackets the same three numbers, 3, 15, 26 as they are.
QUIET_MM, NOISY_MM = 0.5, 0.7
"""Standard errors of the averaged heights: up to the first the network's answer is taken as it is, from the second on
all of `DOUBT` is taken off. Cameras of `easy` and `field` have 0.25 to 0.55 mm, local noise of 0.12 px 0.55 to 0.85.
Larger: poor cameras refuse more (0.4: 3, 14, 25; 0.6: 3, 15, 23, and for the second 0.6: 2, 15, 26; 0.9: 3, 17, 23)."""
DOUBT = 0.5
"""Log-odds that are taken off a noisy patch's answer: noise moves a tuber's towards clod. More: poor cameras refuse
less (0: 3, 18, 17; 1: 2, 13, 31; 1.5: 2, 10, 43)."""
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
    """What the network says of a patch: how much more likely it is for a tuber than for a clod, as natural logarithms.

    Attributes:
        answers: for the patch turned and mirrored, as many as were asked for, at least one.
    """

    answers: tuple[float, ...]
    noise: PatchNoise

    @property
    def log_odds(self) -> float:
        """The mean of all answers."""
        return fmean(self.answers)


@dataclass(frozen=True, slots=True)
class Answer:
    """What is believed of a track: log-odds of tuber against other on this belt, and the evidence of its patch."""

    log_odds: float
    evidence: Evidence


def shrunk(evidence: Evidence) -> float:
    """The network's log-odds, nearer to none where the patch is noisier than those it learned from.

    Holes and few observations are in it: they leave a larger error.
    """
    noisy = (evidence.noise.error_mm - QUIET_MM) / (NOISY_MM - QUIET_MM)
    left = abs(evidence.log_odds) - DOUBT * min(max(noisy, 0.0), 1.0)
    return float(np.copysign(max(left, 0.0), evidence.log_odds))


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
