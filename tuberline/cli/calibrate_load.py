"""`tuberline calibrate load`: what the scale said of a load, for the totals of the loads to come."""

from __future__ import annotations

import json as json_module
import sys
from pathlib import Path


def calibrate_load(
    run_dir: Path,
    /,
    *,
    ticket_kg: float,
    tickets: Path,
    scale_error_kg: float | None = None,
    run: str | None = None,
    again: bool = False,
    json: bool = False,
) -> None:
    """Add the ticket of a counted load to a file of tickets, which then calibrates the totals of later loads.

    The ledger's tubers stay as weighed; totals and summaries are multiplied by the factor that the tickets give, and
    their interval shrinks from 5 % towards what loads differ by. Tickets hold for the weights that weighed the load.

    Parameters
    ----------
    run_dir
        Folder of the counted run (with its ledger.db), or the ledger itself.
    ticket_kg
        Net weight of that load on the scale.
    tickets
        File of tickets; made where it does not exist. Name it as aggregator.tickets in the line's file.
    scale_error_kg
        Standard deviation of the scale and of what is stuck in the trailer; default: 0.5 % of the ticket.
    run
        Which run, where the ledger holds several.
    again
        Replace the ticket that this run has already.
    json
        Print tickets and factor as JSON on stdout.
    """
    from dataclasses import asdict

    from aggregator.calibration.load import ticket_of
    from aggregator.calibration.tickets import load_factor, read_tickets, with_ticket, write_tickets

    sd_g = 1000 * scale_error_kg if scale_error_kg is not None else 5.0 * abs(ticket_kg)
    ticket = ticket_of(run_dir, run=run, ticket_g=1000 * ticket_kg, ticket_sd_g=sd_g)
    known = with_ticket(read_tickets(tickets) if tickets.exists() else (), ticket, again=again)
    write_tickets(tickets, known)
    found = load_factor(known, ticket.model)
    if json:
        told = {"ticket": asdict(ticket), "load_factor": asdict(found) if found else None}
        sys.stdout.write(json_module.dumps(told, indent=2) + "\n")
    elif found:
        number = f"{found.tickets} ticket{'s' * (found.tickets > 1)}"
        sys.stdout.write(
            f"run {ticket.run}: {ticket.estimated_g / 1000:.3f} kg estimated, {ticket.ticket_g / 1000:.3f} kg on the "
            f"scale (ratio {ticket.ticket_g / ticket.estimated_g:.3f})\n"
            f"{number} of {found.model}: totals are multiplied by {found.factor:.3f}, a load is then known to "
            f"{100 * found.half_width:.1f} %\n"
            f'put tickets = "{tickets}" under [aggregator] of the line\'s file\n'
        )
