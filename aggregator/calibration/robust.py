"""The correction of all tickets, each counted by how well the others bear it out; and what more tickets would bring."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from aggregator.calibration.correction import Correction, Prior, fit, prior_sds, usable
from aggregator.calibration.evidence import gather, sum_tickets
from aggregator.calibration.leave_one_out import doubts
from aggregator.calibration.sensitivity import TYPICAL_PER_MM
from aggregator.calibration.tickets import Ticket
from conveyor.statistics import NORMAL_90

NUMBERS = (0, 1, 2, 3, 5, 10)
TYPICAL_TICKET_SD = 0.005


def correction_of(tickets: Sequence[Ticket], model: str, prior: Prior, *, cultivar: str = "") -> Correction:
    """The correction that the tickets of `model` give for tubers of `cultivar`; without tickets it is the prior.

    A ticket that the others contradict counts for little (`leave_one_out.DOUBTFUL_SD`) and widens what is left.
    """
    return _correction_of(usable(tickets, model), model, prior, cultivar)


@lru_cache(maxsize=32)
def _correction_of(tickets: tuple[Ticket, ...], model: str, prior: Prior, cultivar: str) -> Correction:
    return fit(tickets, prior, cultivar=cultivar, doubt=doubts(tickets, prior), model=model)


def expected_accuracy(
    tickets: Sequence[Ticket],
    model: str,
    prior: Prior,
    *,
    per_mm: float | None,
    cultivar: str = "",
) -> dict[int, float]:
    """90 % half-width, as a share, of the next load after `n` more load tickets.

    They say what is expected by now, and loads differ as is expected by now: tickets that agree better will do better.

    Args:
        per_mm: of the loads to come, grams per mm over grams; None: what is typical.
    """
    per_mm = per_mm or TYPICAL_PER_MM
    known = usable(tickets, model)
    now = correction_of(known, model, prior, cultivar=cultivar)
    weight_g = 1e6
    scale_g = weight_g * now.factor[0] * (1.0 + per_mm * now.offset_mm[0])
    more = Ticket("", model, scale_g, TYPICAL_TICKET_SD * scale_g, weight_g, 0.0, 1.0, per_mm_g=per_mm * weight_g)
    more = replace(more, stated_offset_mm=prior.stated_offset_mm, cultivar=cultivar)
    widths, doubt = {}, doubts(known, prior)
    for number in NUMBERS:
        tickets = (*known, *[more] * number)
        found = gather(tickets, now.mean, now.cultivars, np.concatenate([doubt, np.ones(number)]))
        precision = np.diag(1.0 / prior_sds(prior, len(now.cultivars)) ** 2) + found.at(now.load_sd**2)[0]
        slope = sum_tickets([more], now.mean, now.cultivars).slopes[0]
        variance = float(slope @ np.linalg.solve(precision, slope))
        widths[number] = NORMAL_90 * math.sqrt(variance + now.load_sd**2)
    return widths
