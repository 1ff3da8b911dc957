"""Each ticket against what all others say: which one contradicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from aggregator.calibration.correction import Correction, Prior, fit, usable
from aggregator.calibration.evidence import single_weights, sum_tickets
from aggregator.calibration.tickets import Ticket

Floats = NDArray[np.float64]

CONTRADICTS_SD = 3.5
"""A ticket this many standard deviations from what the others (or, alone, the prior) allow is named."""

DOUBTFUL_SD = 2.0
"""A ticket farther than this from what all others say counts as if it were just so far: its variance grows."""


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A ticket and what the others say of it.

    Attributes:
        expected_g: by the correction of the others, those among them that others contradict counted for little.
            apart, sd: ln of ticket over that, and what it may be.
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

    @property
    def told(self) -> str:
        """That it contradicts, in words."""
        return (
            f"contradicts all else that is known: {self.ticket.name} says {self.ticket.ticket_g / 1000:.3f} kg, "
            f"expected are {self.expected_g / 1000:.3f} kg, {abs(self.z):.1f} standard deviations apart; it counts for "
            "little"
        )


@lru_cache(maxsize=32)
def doubts(tickets: tuple[Ticket, ...], prior: Prior) -> Floats:
    """(tickets,) by what each ticket's variance is multiplied for what the others, taken as they are, say of it."""
    alike = np.ones(len(tickets))
    z = np.array([_left_out(tickets, n, prior, alike).z for n in range(len(tickets))])
    return np.maximum(1.0, (z / DOUBTFUL_SD) ** 2)


def leave_one_out(tickets: Sequence[Ticket], model: str, prior: Prior) -> tuple[LeftOut, ...]:
    """Every ticket of `model` against the others in use; those set aside against all in use."""
    known = usable(tickets, model)
    aside = sorted((t for t in tickets if t.model == model and t.set_aside), key=lambda t: t.key)
    doubt = np.append(_doubts_of_others(known, prior), 1.0)
    judged = (_left_out((*known, ticket), len(known), prior, doubt) for ticket in aside)
    return (*_each_left_out(known, prior), *judged)


def contradicting(tickets: Sequence[Ticket], model: str, *, stated_offset_mm: float) -> list[LeftOut]:
    """Tickets of `model` that the others contradict, each with what the others expect of it.

    `stated_offset_mm`: resting offset that the line states; of how well it knows that, nothing is taken for granted.
    """
    prior = Prior(stated_offset_mm=round(stated_offset_mm, 3))  # a mean over stretches differs in its last digits
    return [entry for entry in _each_left_out(usable(tickets, model), prior) if entry.contradicts]


def contradicting_all(tickets: Sequence[Ticket]) -> list[LeftOut]:
    """Tickets that the others of the same weights contradict, each by the resting offset that its own run states."""
    found = []
    for model, offset_mm in dict.fromkeys((t.model, round(t.stated_offset_mm, 3)) for t in tickets):
        entries = contradicting(tickets, model, stated_offset_mm=offset_mm)
        found += [entry for entry in entries if round(entry.ticket.stated_offset_mm, 3) == offset_mm]
    return found


@lru_cache(maxsize=32)
def _each_left_out(tickets: tuple[Ticket, ...], prior: Prior) -> tuple[LeftOut, ...]:
    doubt = _doubts_of_others(tickets, prior)
    return tuple(_left_out(tickets, n, prior, doubt) for n in range(len(tickets)))


def _doubts_of_others(tickets: tuple[Ticket, ...], prior: Prior) -> Floats:
    """As `doubts`; but of two tickets that contradict each other none says which one is wrong: each is believed."""
    return doubts(tickets, prior) if len(tickets) > 2 else np.ones(len(tickets))


def _left_out(tickets: Sequence[Ticket], n: int, prior: Prior, doubt: Floats) -> LeftOut:
    ticket = tickets[n]
    others = fit((*tickets[:n], *tickets[n + 1 :]), prior, cultivar=ticket.cultivar, doubt=np.delete(doubt, n))
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
