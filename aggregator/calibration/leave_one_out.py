"""Each ticket against what all others say: which one contradicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aggregator.calibration.correction import Correction, Prior, fit, usable
from aggregator.calibration.evidence import single_weights, sum_tickets
from aggregator.calibration.tickets import Ticket

Floats = NDArray[np.float64]

CONTRADICTS_SD = 3.5
"""A ticket this many standard deviations from what the others (or, alone, the prior) allow is named."""


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A ticket and what the others say of it.

    Attributes:
        expected_g: by the correction of the others. apart, sd: ln of ticket over that, and what it may be.
    """

    ticket: Ticket
    expected_g: float
    apart: float
    sd: float

    @property
    def z(self) -> float:
        """How many standard deviations apart."""
        return self.apart / self.sd

    @property
    def contradicts(self) -> bool:
        """More than chance explains."""
        return not self.ticket.set_aside and abs(self.z) > CONTRADICTS_SD


def left_out_z(tickets: Sequence[Ticket], prior: Prior) -> Floats:
    """(tickets,) standard deviations that each lies from what the others say."""
    return np.array([_left_out(tickets, n, prior).z for n in range(len(tickets))])


def leave_one_out(tickets: Sequence[Ticket], model: str, prior: Prior) -> tuple[LeftOut, ...]:
    """Every ticket of `model` against the others in use; those set aside against all in use."""
    known = usable(tickets, model)
    aside = sorted((t for t in tickets if t.model == model and t.set_aside), key=lambda t: t.key)
    found = [_left_out(known, n, prior) for n in range(len(known))]
    return (*found, *(_left_out((*known, ticket), len(known), prior) for ticket in aside))


def _left_out(tickets: Sequence[Ticket], n: int, prior: Prior) -> LeftOut:
    ticket = tickets[n]
    others = fit((*tickets[:n], *tickets[n + 1 :]), prior, cultivar=ticket.cultivar)
    apart, variance = difference(ticket, others)
    return LeftOut(ticket, ticket.ticket_g / float(np.exp(apart)), apart, float(np.sqrt(variance)))


def difference(ticket: Ticket, correction: Correction) -> tuple[float, float]:
    """(ln of the ticket over what the correction expects of it, variance of that)."""
    if ticket.singles:
        group = single_weights(ticket, correction.mean, correction.cultivars)
        shares = 1.0 / group.variances
        slope = shares @ group.slopes / shares.sum()
        # Single weights are predicted the other way round: what reads heavy has a scale that reads light.
        apart, own = -float(shares @ group.residuals / shares.sum()), float(1.0 / shares.sum())
    else:
        group = sum_tickets([ticket], correction.mean, correction.cultivars)
        slope, apart, own = group.slopes[0], float(group.residuals[0]), float(group.variances[0])
    return apart, own + correction.load_sd**2 + float(slope @ correction.covariance @ slope)
