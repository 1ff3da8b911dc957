"""`tuberline calibrate bucket`: one bucket of tubers that passed the line and then stood on a scale."""

from __future__ import annotations

import json as json_module
import sys
from pathlib import Path

from tuberline.cli.numbers import ScaleErrorKg, TicketKg
from tuberline.cli.ticket_options import NO_TICKET_OPTIONS, WHOLE_RUN, PartOptions, TicketOptions

SCALE_SHARE = 0.002
LEAST_SCALE_KG = 0.01


def calibrate_bucket(
    run_dir: Path,
    /,
    *,
    kg: TicketKg,
    count: int | None = None,
    scale_error_kg: ScaleErrorKg | None = None,
    weighed: PartOptions = WHOLE_RUN,
    options: TicketOptions = NO_TICKET_OPTIONS,
    json: bool = False,
) -> None:
    """Calibrate by one bucket: tubers that passed the line, were caught, and were weighed together.

    Parameters
    ----------
    run_dir
        Folder of the counted run (with its ledger.db), or the ledger itself.
    kg
        What the tubers weigh, net.
    count
        How many they are, counted by hand; default: as many as the run counted.
    scale_error_kg
        Standard deviation of the scale; default: 0.2 % of the weight, at least 10 g.
    weighed
        The part of the run that was in the bucket.
    options
        Where the ticket goes.
    json
        Print ticket and correction as JSON on stdout.
    """
    from aggregator.calibration.learning import learning_of
    from aggregator.calibration.load import bucket_ticket
    from tuberline.cli.calibration_told import after_ticket, as_json

    sd_kg = scale_error_kg if scale_error_kg is not None else max(LEAST_SCALE_KG, SCALE_SHARE * abs(kg))
    ticket, tubers = bucket_ticket(
        run_dir,
        run=options.run,
        part=weighed.part(),
        ticket_g=1000 * kg,
        ticket_sd_g=1000 * sd_kg,
        count=count,
        cultivar=options.cultivar,
        stated_offset_mm=options.resting_offset_mm,
    )
    known = options.add(ticket)
    learning = learning_of(tubers)
    if json:
        sys.stdout.write(json_module.dumps(as_json(known, ticket, learning), indent=2) + "\n")
    else:
        sys.stdout.write(after_ticket(known, ticket, options.tickets, learning))
