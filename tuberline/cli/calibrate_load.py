"""`tuberline calibrate load`: what the scale said of a load, for the totals of the loads to come."""

from __future__ import annotations

import json as json_module
import sys
from pathlib import Path

from tuberline.cli.numbers import ScaleErrorKg, TicketKg
from tuberline.cli.ticket_options import NO_TICKET_OPTIONS, TicketOptions


def calibrate_load(
    run_dir: Path,
    /,
    *,
    ticket_kg: TicketKg | None = None,
    load: str = "",
    scale_error_kg: ScaleErrorKg | None = None,
    options: TicketOptions = NO_TICKET_OPTIONS,
    json: bool = False,
) -> None:
    """Add the ticket of a counted load to a file of tickets, which then calibrates the totals of later loads.

    The ledger's tubers stay as weighed; totals and summaries are corrected by what all tickets say, and their interval
    shrinks towards what loads differ by. Tickets hold for the weights that weighed the load.

    Parameters
    ----------
    run_dir
        Folder of the counted run (with its ledger.db), or the ledger itself.
    ticket_kg
        Net weight of the whole run on the scale; where loads were started in it, give --load instead.
    load
        A load of that ledger, by number or name, whose ticket was entered with `tuberline load ticket`.
    scale_error_kg
        Standard deviation of the scale and of what is stuck in the trailer; default: 0.5 % of the ticket.
    options
        Where the ticket goes.
    json
        Print tickets and factor as JSON on stdout.
    """
    from aggregator.calibration.load import ticket_of
    from aggregator.ledger.load_totals import ticket_of_load
    from conveyor.errors import InputError
    from tuberline.cli.calibration_told import after_ticket, as_json

    if (ticket_kg is None) != bool(load):
        raise InputError(
            "give the run's net weight with --ticket-kg, or a load of the ledger that has a ticket, --load"
        )
    of_run = {
        "--run": options.run,
        "--scale-error-kg": scale_error_kg,
        "--resting-offset-mm": options.resting_offset_mm,
    }
    if load and (named := [option for option, value in of_run.items() if value is not None]):
        raise InputError(
            f"{' and '.join(named)}: the ledger knows this of load '{load}' and of its ticket; leave it out (a scale's "
            "error: `tuberline load ticket --scale-error-kg`)"
        )
    if ticket_kg is None:
        ticket = ticket_of_load(run_dir, load, cultivar=options.cultivar)
    else:
        ticket = ticket_of(
            run_dir,
            run=options.run,
            ticket_g=1000 * ticket_kg,
            ticket_sd_g=1000 * scale_error_kg if scale_error_kg is not None else 5.0 * abs(ticket_kg),
            cultivar=options.cultivar,
            stated_offset_mm=options.resting_offset_mm,
        )
    known = options.add(ticket)
    if json:
        sys.stdout.write(json_module.dumps(as_json(known, ticket), indent=2) + "\n")
    else:
        sys.stdout.write(after_ticket(known, ticket, options.tickets))
