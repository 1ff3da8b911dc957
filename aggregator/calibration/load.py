"""From a run in the ledger and what the scale said of it to a load ticket."""

from __future__ import annotations

from pathlib import Path

from aggregator.calibration.tickets import Ticket, check_ticket
from aggregator.core.totals import LoadTotals
from aggregator.ledger.reader import coverage_of, ledger_file, read_sums, reading, the_run
from conveyor.errors import InputError
from conveyor.statistics import NORMAL_90

LEAST_SHARE = 0.95
"""Of a load's weight that one set of weights must have weighed: its ticket says nothing about any other."""


def ticket_of(path: Path, *, run: str | None, ticket_g: float, ticket_sd_g: float) -> Ticket:
    """The ticket of the run in the folder (or ledger) `path`.

    Raises:
        LedgerError: no ledger, or not that run. InputError: the load cannot be calibrated with; the text says why.
    """
    ledger = ledger_file(path)
    with reading(ledger) as view:
        chosen = the_run(view, ledger, run)
        sums = read_sums(view, chosen.run)
    load = LoadTotals(sums.load)
    seen = coverage_of(chosen, sums)
    share = seen.share or 0.0
    estimated_g, low_g, high_g = load.estimated(share, belt_m=seen.belt_m)
    own_g = sum(load.own_error_g()) / 2
    # The unseen belt is random from load to load, the bias that all tubers share is what the ticket is to measure.
    seen_low_g, seen_high_g = load.interval_g()
    unseen_g = max(0.0, (high_g - low_g) - (seen_high_g - seen_low_g) / max(share, 1e-9)) / 2
    model = _model_of(load, chosen.run)
    estimated_sd_g = (own_g / max(share, 1e-9) + unseen_g) / NORMAL_90
    return check_ticket(Ticket(chosen.run, model, ticket_g, ticket_sd_g, estimated_g, estimated_sd_g, share))


def _model_of(load: LoadTotals, run: str) -> str:
    shares: dict[str, float] = {}
    for (_, model), (_, weight_g) in load.sums.weighed.items():
        shares[model] = shares.get(model, 0.0) + weight_g
    model = max(shares, key=lambda name: shares[name], default="")
    if shares and (not model or shares[model] < LEAST_SHARE * sum(shares.values())):
        told = ", ".join(f"{name or 'visible volume'} {grams / 1000:.1f} kg" for name, grams in sorted(shares.items()))
        raise InputError(
            f"run {run} was weighed by several: {told}; a ticket needs a load of which one set of weights weighed at "
            f"least {100 * LEAST_SHARE:.0f} %"
        )
    return model
