"""What tickets say of offset, factor and cultivar, linearised at a guess (`aggregator.calibration.correction`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aggregator.calibration.sensitivity import share_of_weight
from aggregator.calibration.tickets import Ticket
from conveyor.typed_names import name_key

Floats = NDArray[np.float64]

LEAST_BASE = 0.2
"""However deep tubers may lie, at least this share of a weight is not offset: keeps a bad guess finite."""

OUTLIER_SD = 2.0
"""A single weight farther than this from the others counts as if it were just so far."""

FEW_SINGLES = 10
"""From fewer single weights their scatter is not measured; it is what the ledger states."""


@dataclass(frozen=True, slots=True)
class Group:
    """Observations that share what differs from load to load: a sum alone, or the single weights of a session.

    Attributes:
        slopes: (n, p) change of the prediction with each parameter. residuals, variances: (n,), of logarithms.
        doubt: what variances, the shared one too, are multiplied with.
    """

    slopes: Floats
    residuals: Floats
    variances: Floats
    doubt: float = 1.0


@dataclass(frozen=True, slots=True)
class Evidence:
    """Groups of observations; `at` adds up what they say for one variance between loads."""

    sums: Group
    sums_doubt: Floats
    sessions: tuple[Group, ...]

    def at(self, load_variance: float) -> tuple[Floats, Floats, float, float]:
        """(information (p, p), pull (p,), r' C^-1 r, ln det C)."""
        variances = self.sums_doubt * (self.sums.variances + load_variance)
        scaled = self.sums.slopes / variances[:, None]
        information, pull = scaled.T @ self.sums.slopes, scaled.T @ self.sums.residuals
        fault = float(self.sums.residuals @ (self.sums.residuals / variances))
        log_det = float(np.log(variances).sum())
        for session in self.sessions:
            parts = _session(session, load_variance)
            information, pull = information + parts[0], pull + parts[1]
            fault, log_det = fault + parts[2], log_det + parts[3]
        return information, pull, fault, log_det


def _session(group: Group, load_variance: float) -> tuple[Floats, Floats, float, float]:
    """The same of one session, whose covariance is diagonal plus a constant (Sherman and Morrison)."""
    variances, shared = group.doubt * group.variances, group.doubt * load_variance
    scaled = group.slopes / variances[:, None]
    ones_j, ones_r, ones = scaled.sum(axis=0), float((group.residuals / variances).sum()), float((1 / variances).sum())
    take = shared / (1.0 + shared * ones)
    return (
        scaled.T @ group.slopes - take * np.outer(ones_j, ones_j),
        scaled.T @ group.residuals - take * ones_j * ones_r,
        float(group.residuals @ (group.residuals / variances)) - take * ones_r**2,
        float(np.log(variances).sum() + np.log1p(shared * ones)),
    )


def gather(tickets: Sequence[Ticket], at: Floats, cultivars: Sequence[str], doubt: Floats) -> Evidence:
    """All tickets linearised at the parameters `at` (offset in mm, ln factor, ln of each cultivar)."""
    which = np.array([bool(ticket.singles) for ticket in tickets], bool)
    sums = [ticket for ticket in tickets if not ticket.singles]
    sessions = tuple(
        single_weights(ticket, at, cultivars, doubt=float(doubt[n])) for n, ticket in enumerate(tickets) if which[n]
    )
    return Evidence(sum_tickets(sums, at, cultivars), doubt[~which], sessions)


def sum_tickets(tickets: Sequence[Ticket], at: Floats, cultivars: Sequence[str]) -> Group:
    """Loads and buckets, one row each."""
    figures = np.array(
        [[t.ticket_g, t.estimated_g, t.grams_per_mm, t.stated_offset_mm, t.sd] for t in tickets], float
    ).reshape(-1, 5)
    scale_g, weighed_g, per_mm_g, stated_mm, sd = figures.T
    base_g = np.maximum(weighed_g + per_mm_g * (at[0] - stated_mm), LEAST_BASE * weighed_g)
    member = _members(tickets, cultivars)
    slopes = np.column_stack([per_mm_g / base_g, np.ones(len(tickets)), member])
    predicted = np.log(base_g) + at[1] + member @ at[2:]
    return Group(slopes, np.log(scale_g) - predicted, sd**2)


def _members(tickets: Sequence[Ticket], cultivars: Sequence[str]) -> Floats:
    keys = [name_key(name) for name in cultivars]
    rows = [[name_key(ticket.cultivar) == key for key in keys] for ticket in tickets]
    return np.array(rows, float).reshape(len(tickets), len(cultivars))


def single_weights(ticket: Ticket, at: Floats, cultivars: Sequence[str], *, doubt: float = 1.0) -> Group:
    """One session of single weights, one row each; rows that stand apart from the others count for little."""
    singles = np.array([[s.scale_g, s.weighed_g, s.sd_g, s.per_mm_g] for s in ticket.singles], float)
    scale_g, weighed_g, sd_g, per_mm_g = singles.T
    # The outline measured carries errors of the weight beside it: the session's own mean curve has none.
    per_mm_g = share_of_weight(scale_g, per_mm_g) * scale_g
    member = _members([ticket], cultivars)
    told_g = scale_g * np.exp(-at[1] - float((member @ at[2:])[0]))
    predicted_g = np.maximum(told_g - per_mm_g * (at[0] - ticket.stated_offset_mm), LEAST_BASE * scale_g)
    factor_slope = -told_g / predicted_g
    slopes = np.column_stack([-per_mm_g / predicted_g, factor_slope, factor_slope[:, None] * member])
    residuals = np.log(weighed_g / predicted_g)
    sd = sd_g / weighed_g
    apart = np.abs(residuals - np.median(residuals)) / sd
    if len(sd) >= FEW_SINGLES:
        scatter = float(np.clip(1.4826 * np.median(apart), 0.5, 3.0))
        sd, apart = scatter * sd, apart / scatter
    return Group(slopes, residuals, (sd * np.maximum(1.0, apart / OUTLIER_SD)) ** 2, doubt)
