"""`tuberline calibrate bucket`: one bucket of tubers that passed the line and then stood on a scale."""

from __future__ import annotations

import json as json_module
import sys
from pathlib import Path

SCALE_SHARE = 0.002
LEAST_SCALE_KG = 0.01


def calibrate_bucket(
    run_dir: Path,
    /,
    *,
    kg: float,
    count: int | None = None,
    tickets: Path = Path("tickets.json"),
    scale_error_kg: float | None = None,
    first: int | None = None,
    last: int | None = None,
    from_x: float | None = None,
    to_x: float | None = None,
    run: str | None = None,
    again: bool = False,
    cultivar: str = "",
    resting_offset_mm: float = 0.0,
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
    tickets
        File of tickets; made where it does not exist. Name it as aggregator.tickets in the line's file.
    scale_error_kg
        Standard deviation of the scale; default: 0.2 % of the weight, at least 10 g.
    first, last
        Ids of the first and last tuber in the bucket, where it is a part of the run (see tubers.csv).
    from_x, to_x
        The same by places on the belt, metres (place_x_m in tubers.csv).
    run
        Which run, where the ledger holds several.
    again
        Replace the ticket that this part has already.
    cultivar
        Name of the cultivar; each gets a factor of its own. Name it as aggregator.cultivar for runs to come.
    resting_offset_mm
        Resting offset that the run was weighed with.
    json
        Print ticket and correction as JSON on stdout.
    """
    from aggregator.calibration.load import Part, bucket_ticket
    from tuberline.cli.calibration_told import add_ticket, after_ticket, as_json

    sd_kg = scale_error_kg if scale_error_kg is not None else max(LEAST_SCALE_KG, SCALE_SHARE * abs(kg))
    ticket = bucket_ticket(
        run_dir,
        run=run,
        part=Part(first, last, from_x, to_x),
        ticket_g=1000 * kg,
        ticket_sd_g=1000 * sd_kg,
        count=count,
        cultivar=cultivar,
        stated_offset_mm=resting_offset_mm,
    )
    known = add_ticket(tickets, ticket, again=again)
    if json:
        sys.stdout.write(json_module.dumps(as_json(known, ticket), indent=2) + "\n")
    else:
        sys.stdout.write(after_ticket(known, ticket, tickets))
