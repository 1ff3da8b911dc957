"""From a load of the ledger and its ticket to evidence for the calibration."""

from __future__ import annotations

import math

from aggregator.calibration.correction import Prior
from aggregator.calibration.load import LEAST_SHARE, MISCOUNTED
from aggregator.calibration.tickets import Ticket, check_scale, check_ticket
from aggregator.core.load_sums import LoadSums
from aggregator.core.load_told import LoadCounted
from aggregator.core.loads import Load
from aggregator.core.totals import LoadTotals
from conveyor.errors import InputError


def load_ticket(load: Load, found: LoadCounted, *, cultivar: str = "") -> Ticket | None:
    """What the net ticket of a load says; None where it has none.

    Args:
        cultivar: where the load names no variety of its own.

    Raises:
        InputError: the load cannot be calibrated with; the text says why.
    """
    said = load.ticket(net=True)
    if said is None or said.ticket_g is None:
        return None
    if load.undone or not load.spans:
        raise InputError(f"{load.told} holds no belt: its start was undone")
    if found.open:
        raise InputError(f"{load.told} is still open: a ticket is held against all of it, once it has ended")
    sums, coverage = found.sums, found.coverage or 0.0
    totals = LoadTotals(sums)
    whole = totals.whole(coverage, belt_m=found.belt_m)
    estimated_g, _, _ = totals.estimated(coverage, belt_m=found.belt_m)
    own_g2 = (sums.low_variance_g2 + sums.high_variance_g2) / 2 + MISCOUNTED * sums.squares_g2
    ticket = check_ticket(
        Ticket(
            load.run,
            _model(load, sums),
            said.ticket_g,
            said.sd_g,
            estimated_g,
            math.hypot(whole * math.sqrt(own_g2), totals.unshared_sd_g(coverage, belt_m=found.belt_m)),
            coverage,
            part=f"load {load.number}",
            tubers=sums.count,
            per_mm_g=whole * sums.per_mm_g,
            stated_offset_mm=found.known_before(Prior(load.stated_offset_mm)).stated_offset_mm,
            cultivar=load.variety or cultivar,
        )
    )
    return check_scale(ticket)


def _model(load: Load, sums: LoadSums) -> str:
    shares: dict[str, float] = {}
    for (_method, model), (_n, grams) in sums.weighed.items():
        shares[model] = shares.get(model, 0.0) + grams
    model = max(shares, key=lambda name: shares[name], default="")
    if shares and (not model or shares[model] < LEAST_SHARE * sums.as_weighed_g):
        told = ", ".join(f"{name or 'visible volume'} {grams / 1000:.1f} kg" for name, grams in sorted(shares.items()))
        raise InputError(
            f"{load.told} was weighed by several: {told}; a ticket needs a load of which one set of weights weighed at "
            f"least {100 * LEAST_SHARE:.0f} %"
        )
    return model
