"""One small Bayesian correction of all tickets: resting offset, factor, cultivar.

A tuber that lies d mm lower than stated reads `a * d` grams light, where a is about density times its outline
(`aggregator.calibration.sensitivity`); density, the camera's depth scale and what the weights misjudge in all tubers
are a factor. With W and A the sums of weights and of a over the tubers that met a scale,

    ln scale = ln factor + ln cultivar + ln(W + A * (offset - stated)) + u + e,       u ~ N(0, s_load^2), e own error

and for each single weight t the same told the other way round, `w = t / factor - a(t) * (offset - stated)`: t is exact
and w is not, and regressing t on a noisy w would make an offset of mere noise. s_load is what differs from load to load
(soil, moisture, shapes); it is not known and is averaged over a few values by how well each explains the tickets.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aggregator.calibration.evidence import Evidence, gather
from aggregator.calibration.tickets import Ticket
from conveyor import load_spread
from conveyor.load_spread import CULTIVAR_SD, FACTOR_SD, OFFSET_SD_MM, factor_sd
from conveyor.resting import RestingLevel
from conveyor.typed_names import as_first_given, name_key

Floats = NDArray[np.float64]

LOAD_SDS = np.array(load_spread.LOAD_SDS)
LOAD_SD_CHANCES = np.array(load_spread.LOAD_SD_CHANCES)

KNOWN_SD = 1e-4
"""What is stated as known exactly is known to this (0.1 um, 0.01 %)."""

ROUNDS = 6


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known of a run before any ticket: the offset it states, how well, and the other two."""

    stated_offset_mm: float = 0.0
    offset_sd_mm: float = OFFSET_SD_MM
    factor_sd: float = FACTOR_SD
    cultivar_sd: float = CULTIVAR_SD


def stated_mm(belt: Mapping[str, Any]) -> float:
    """Where a line states that ordinary undersides lie, mm: section `belt` as `prior_told` takes it.

    On a web that is the offset and the sink of an ordinary tuber: tickets of a time when the line did not say that its
    belt is one hold afterwards, too.
    """
    return float(belt.get("resting_offset_mm") or 0.0) + sink_mm(belt)


def sink_mm(belt: Mapping[str, Any]) -> float:
    """Of that, what the rods of a web do, mm; 0 on other belts."""
    if belt.get("surface") != "rods":
        return 0.0
    rods = {f"{key}_m": float(belt[f"{key}_mm"]) / 1000 for key in ("rod_pitch", "rod_diameter") if f"{key}_mm" in belt}
    return 1000 * RestingLevel("rods", **rods).ordinary_m


def prior_told(belt: Mapping[str, Any]) -> Prior:
    """What a line states of its resting level: section `belt` of its config or summary, with `plane_sd_mm`.

    As wide as before any calibration where it does not say how well. What it states lies under the belt plane, and that
    is as well known as the views' own intervals take it to be. Rods in view as a gauge make the factor known better.
    """
    offset_mm, sd_mm = stated_mm(belt), belt.get("resting_sd_mm")
    factor = factor_sd(gauged=belt.get("gauge") == "rods")
    if sd_mm is None:
        return Prior(stated_offset_mm=offset_mm, factor_sd=factor)
    both_mm = min(math.hypot(float(sd_mm), float(belt.get("plane_sd_mm") or 0.0)), OFFSET_SD_MM)
    return Prior(stated_offset_mm=offset_mm, offset_sd_mm=max(both_mm, float(sd_mm)), factor_sd=factor)


@dataclass(frozen=True, slots=True)
class Correction:
    """What tickets and prior come to.

    Attributes:
        cultivars: named ones, each as first given; their parameters follow offset and factor.
        mean: (2 + cultivars,) offset in mm (absolute, positive below the belt plane), ln factor, ln of each cultivar.
        covariance: of `mean`.
        load_sd: what still differs from load to load, as a share.
        prior: what it began with. used: tickets by kind.
    """

    model: str
    cultivars: tuple[str, ...]
    mean: Floats
    covariance: Floats
    load_sd: float
    prior: Prior
    used: tuple[tuple[str, int], ...]

    @property
    def offset_mm(self) -> tuple[float, float]:
        """(mean, standard deviation) of the resting offset beyond what is stated, mm."""
        return float(self.mean[0]) - self.prior.stated_offset_mm, float(np.sqrt(self.covariance[0, 0]))

    @property
    def factor(self) -> tuple[float, float]:
        """(mean, standard deviation) of the factor."""
        return float(np.exp(self.mean[1])), float(np.exp(self.mean[1]) * np.sqrt(self.covariance[1, 1]))

    def cultivar_factor(self, cultivar: str) -> tuple[float, float]:
        """(mean, standard deviation) of a cultivar's own factor; of one without tickets what the prior says."""
        if (at := self.at(cultivar)) is None:
            return 1.0, self.prior.cultivar_sd
        return float(np.exp(self.mean[at])), float(np.exp(self.mean[at]) * np.sqrt(self.covariance[at, at]))

    def at(self, cultivar: str) -> int | None:
        """Where in `mean` a cultivar's own factor is; None where it is none of them."""
        keys = [name_key(name) for name in self.cultivars]
        return 2 + keys.index(key) if (key := name_key(cultivar)) in keys else None

    @property
    def tickets(self) -> int:
        """How many it rests on."""
        return sum(number for _, number in self.used)


def usable(tickets: Sequence[Ticket], model: str) -> tuple[Ticket, ...]:
    """Tickets of `model` that are not set aside, in an order that does not depend on the file's."""
    return tuple(sorted((t for t in tickets if t.model == model and not t.set_aside), key=lambda t: t.key))


def fit(
    tickets: Sequence[Ticket], prior: Prior, *, cultivar: str = "", doubt: Floats | None = None, model: str = ""
) -> Correction:
    """The posterior: linearised about its own mean until that stands, mixed over `LOAD_SDS`.

    Args:
        doubt: (tickets,) by what each ticket's variance is multiplied.
    """
    found = as_first_given([*(ticket.cultivar for ticket in tickets), cultivar])
    cultivars = tuple(found[key] for key in sorted(found))
    prior_mean = np.array([prior.stated_offset_mm, 0.0, *[0.0] * len(cultivars)])
    prior_sd = prior_sds(prior, len(cultivars))
    precision = np.diag(1.0 / prior_sd**2)
    doubt = np.ones(len(tickets)) if doubt is None else doubt
    mean, covariance, load_sd = prior_mean, np.diag(prior_sd**2), _rms(LOAD_SD_CHANCES)
    for _ in range(ROUNDS if len(tickets) else 0):
        evidence = gather(tickets, mean, cultivars, doubt)
        mean, covariance, load_sd = _mixed(evidence, mean, prior_mean - mean, precision)
    used = tuple(sorted(Counter(ticket.kind for ticket in tickets).items()))
    return Correction(model, cultivars, mean, covariance, load_sd, prior, used)


def prior_sds(prior: Prior, cultivars: int) -> Floats:
    """(2 + cultivars,) standard deviations of the parameters before any ticket."""
    sds = np.array([prior.offset_sd_mm, prior.factor_sd, *[prior.cultivar_sd] * cultivars])
    return np.asarray(np.maximum(sds, KNOWN_SD), np.float64)


def _mixed(found: Evidence, at: Floats, prior_step: Floats, prior_precision: Floats) -> tuple[Floats, Floats, float]:
    """(mean, covariance, s_load) of the mixture over what loads may differ by, linearised at `at`."""
    steps, inverses, scores = [], [], []
    for load_sd, chance in zip(LOAD_SDS, LOAD_SD_CHANCES, strict=True):
        information, pull, fault, log_det = found.at(load_sd**2)
        precision = prior_precision + information
        towards = prior_precision @ prior_step + pull
        inverse = np.linalg.inv(precision)
        step = inverse @ towards
        quadratic = prior_step @ prior_precision @ prior_step + fault - towards @ step
        scores.append(np.log(chance) - 0.5 * (quadratic + log_det + np.linalg.slogdet(precision)[1]))
        steps.append(step)
        inverses.append(inverse)
    chances = np.exp(np.array(scores) - max(scores))
    chances /= chances.sum()
    step = chances @ np.array(steps)
    apart = np.array(steps) - step
    covariance = np.einsum("k,kij->ij", chances, np.array(inverses)) + np.einsum("k,ki,kj->ij", chances, apart, apart)
    return at + step, covariance, _rms(chances)


def _rms(chances: Floats) -> float:
    return float(np.sqrt(chances @ LOAD_SDS**2))
