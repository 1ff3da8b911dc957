"""A load's weight and 90 % interval by the correction, and what the interval is made of."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from aggregator.calibration.correction import Correction, Prior, usable
from aggregator.calibration.robust import correction_of
from aggregator.calibration.sensitivity import TYPICAL_PER_MM
from aggregator.calibration.tickets import Ticket
from aggregator.core.load_sums import CameraDoubt
from conveyor.load_spread import OTHER_CAMERA_SD, UNGAUGED_SD
from conveyor.statistics import NORMAL_90

VOLUME_SD = 0.06
"""Of what all weights by visible volume have in common, beside what the correction knows: a half-width of 10 %."""

OFF_SD_PER_MM = 0.0065
"""Of what they have in common for each millimetre that the belt is seen off its calibration: a mount that moved costs
nothing, for the belt is followed; a disparity that drifted by as much costs 4 d / z of a volume, 0.9 % a millimetre at
0.46 m and 1.2 % at 0.345 m. Without a gauge it is not known which: a half-width of 1.07 % a millimetre."""

LEAST_TOLD_G, LEAST_COVERAGE, MOST_TOLD_PERCENT = 1e-3, 1e-9, 1e6
"""Of less no percentages are told: they would not be finite numbers."""

RESTING, CAMERA, TUBERS, LAYERS, UNSEEN = "resting level", "camera", "tubers", "more than one layer", "belt not seen"
"""What an interval is made of. Camera: depth scale, density and what the weights misjudge in all tubers. Tubers: each
one's own error, the cultivar, and what differs from load to load. More than one layer: what lies under others, and
how high those lie (`aggregator.core.layers`); it is left out where the belt carries one layer."""


@dataclass(frozen=True, slots=True)
class Calibrated:
    """Weight of what was seen, grams.

    Attributes:
        low_sd_g, high_sd_g: standard deviations below and above.
        parts_g: standard deviation by what causes it; their squares add up to the mean of the two squared.
        corrections: by model. own_g: standard deviation of the tubers' own errors, of their sum; between_g: of what
            differs from load to load. Both are within `parts_g`, under `TUBERS`.
    """

    weight_g: float
    low_sd_g: float
    high_sd_g: float
    parts_g: Mapping[str, float]
    corrections: Mapping[str, Correction]
    own_g: float = 0.0
    between_g: float = 0.0

    @property
    def tickets(self) -> int:
        """Tickets of the weights that weighed this load."""
        return sum(correction.tickets for correction in self.corrections.values())

    @property
    def told(self) -> str:
        """By what it is calibrated, in words; '' where by nothing."""
        return "; ".join(told(correction) for _, correction in sorted(self.corrections.items()) if correction.tickets)


def calibrated(
    weighed_g: Mapping[tuple[str, str], float],
    *,
    per_mm_g: float,
    own_variance_g2: tuple[float, float],
    tickets: Sequence[Ticket] = (),
    prior: Prior | None = None,
    cultivar: str = "",
    camera_sd: float = 0.0,
) -> Calibrated:
    """The load as the tickets of its weights have it.

    Args:
        weighed_g: sums of tubers as weighed, by method and model.
        per_mm_g: growth of their sum with each millimetre tubers lie lower; 0: not known, the typical one is taken.
        own_variance_g2: sums of the tubers' own variances below and above.
        camera_sd: what is doubtful of the cameras of this load, as a share of its weight (`camera_sd`).
    """
    prior = prior or Prior()
    raw_g = sum(weighed_g.values())
    per_mm = per_mm_g / raw_g if raw_g > 0 and per_mm_g > 0 else TYPICAL_PER_MM
    corrections = {model: correction_of(tickets, model, prior, cultivar=cultivar) for _, model in weighed_g}
    weight_g, between_g, shared_g = 0.0, 0.0, dict.fromkeys((RESTING, CAMERA, TUBERS), 0.0)
    for (method, model), grams in weighed_g.items():
        one_g, parts = _one(corrections[model], grams, per_mm * grams, cultivar)
        if method == "volume":
            parts[CAMERA] = math.hypot(parts[CAMERA], VOLUME_SD * one_g)
        parts[CAMERA] = math.hypot(parts[CAMERA], camera_sd * one_g)
        weight_g += one_g
        between_g += corrections[model].load_sd * one_g
        # What weights of several models misjudge, they misjudge together: half-widths add up.
        shared_g = {name: shared_g[name] + parts[name] for name in shared_g}
    scale = weight_g / raw_g if raw_g > 0 else 1.0
    shared = math.hypot(*shared_g.values())
    low_sd_g, high_sd_g = (math.hypot(scale * math.sqrt(own), shared) for own in own_variance_g2)
    own_g = scale * math.sqrt(sum(own_variance_g2) / 2)
    shared_g[TUBERS] = math.hypot(shared_g[TUBERS], own_g)
    return Calibrated(weight_g, low_sd_g, high_sd_g, shared_g, corrections, own_g, between_g)


def camera_sd(doubt: CameraDoubt) -> float:
    """Standard deviation, as a share of a load, of what is doubtful of its cameras, whatever the tickets say: a camera
    may have changed since.
    """
    return math.hypot(
        OTHER_CAMERA_SD * doubt.unlike_share, OFF_SD_PER_MM * doubt.off_mm, UNGAUGED_SD * doubt.ungauged_share
    )


def _one(correction: Correction, weighed_g: float, per_mm_g: float, cultivar: str) -> tuple[float, dict[str, float]]:
    """(calibrated grams, standard deviations by cause) of tubers that one set of weights weighed.

    Offset and factor are known together better than each alone: each cause takes its part of the joint variance.
    """
    at = correction.at(cultivar)
    assert at is not None  # it was made for this cultivar
    multiplier = math.exp(correction.mean[1] + correction.mean[at])
    weight_g = multiplier * max(weighed_g + per_mm_g * correction.offset_mm[0], 0.2 * weighed_g)
    gradient = np.zeros(len(correction.mean))
    gradient[0], gradient[1], gradient[at] = multiplier * per_mm_g, weight_g, weight_g
    shares = gradient * (correction.covariance @ gradient)
    total = max(float(shares.sum()), 0.0)
    kept = np.maximum(shares, 0.0)
    kept *= total / max(float(kept.sum()), 1e-12)
    between = (correction.load_sd * weight_g) ** 2
    return weight_g, {
        RESTING: math.sqrt(kept[0]),
        CAMERA: math.sqrt(kept[1]),
        TUBERS: math.sqrt(float(kept[2:].sum()) + between),
    }


def parts_percent(
    seen: Calibrated, *, estimated_g: float, low_g: float, high_g: float, coverage: float, layers_g: float = 0.0
) -> dict[str, float]:
    """90 % half-widths by cause in percent of the estimate; their squares add up to the whole interval's.

    `layers_g`: standard deviation of what more than one layer leaves open. Empty where nothing was weighed.
    """
    if estimated_g < LEAST_TOLD_G:
        return {}
    coverage = max(coverage, LEAST_COVERAGE)
    sd_g_of = {**seen.parts_g, **({LAYERS: layers_g} if layers_g > 0 else {})}
    parts = {name: 100 * NORMAL_90 * sd_g / coverage / estimated_g for name, sd_g in sd_g_of.items()}
    whole = 100 * (high_g - low_g) / 2 / estimated_g
    parts[UNSEEN] = math.sqrt(max(whole**2 - sum(part**2 for part in parts.values()), 0.0))
    return {name: round(min(part, MOST_TOLD_PERCENT), 2) for name, part in parts.items()}


_KINDS = {
    "load": ("load ticket", "load tickets"),
    "bucket": ("bucket", "buckets"),
    "tubers": ("set of single weights", "sets of single weights"),
}


def told(correction: Correction) -> str:
    """A correction in words: what it rests on, and what it says."""
    by = ", ".join(f"{number} {_KINDS[kind][number > 1]}" for kind, number in correction.used)
    (offset, offset_sd), (factor, factor_sd) = correction.offset_mm, correction.factor
    offset_half, factor_half = NORMAL_90 * offset_sd, NORMAL_90 * factor_sd
    return f"{by}: offset {offset:+.1f} mm +- {offset_half:.1f}, factor {factor:.3f} +- {factor_half:.3f}"


@dataclass(frozen=True, slots=True)
class LoadFactor:
    """What a typical load by `model` is multiplied with, and the 90 % half-width of what is left, as a share of it."""

    model: str
    factor: float
    half_width: float
    tickets: int


def load_factor(
    tickets: Sequence[Ticket], model: str, prior: Prior | None = None, *, cultivar: str = ""
) -> LoadFactor | None:
    """The correction as one figure, for a load of the tickets' own mix of sizes; None without tickets of `model`."""
    known = usable(tickets, model)
    if not known:
        return None
    weighed_g = sum(ticket.estimated_g for ticket in known)
    found = calibrated(
        {("pointraft", model): weighed_g},
        per_mm_g=sum(ticket.grams_per_mm for ticket in known),
        own_variance_g2=(0.0, 0.0),
        tickets=known,
        prior=prior,
        cultivar=cultivar,
    )
    return LoadFactor(model, found.weight_g / weighed_g, NORMAL_90 * found.high_sd_g / found.weight_g, len(known))
