"""`tuberline calibrate tubers`: single weights of tubers that passed the line, in belt order."""

from __future__ import annotations

import json as json_module
import sys
from pathlib import Path
from typing import Annotated

from tuberline.cli.numbers import within
from tuberline.cli.ticket_options import NO_TICKET_OPTIONS, WHOLE_RUN, PartOptions, TicketOptions


def calibrate_tubers(
    run_dir: Path,
    weights: Path,
    /,
    *,
    scale_error_g: Annotated[float, within(0, 1000, "g")] = 1.0,
    weighed: PartOptions = WHOLE_RUN,
    options: TicketOptions = NO_TICKET_OPTIONS,
    json: bool = False,
) -> None:
    """Calibrate by single weights: they tell an offset in millimetres from a factor, which one sum cannot.

    A tuber that was not weighed, or a weight without a tuber, is found and left out.

    Parameters
    ----------
    run_dir
        Folder of the counted run (with its ledger.db), or the ledger itself.
    weights
        CSV file, one tuber a row in the order of the belt; grams in the column weight_g, or in the only column.
        Columns may be kept apart by semicolons or tabs, decimals then by a comma.
    scale_error_g
        Standard deviation of the scale.
    weighed
        The part of the run that was weighed.
    options
        Where the ticket goes.
    json
        Print ticket and correction as JSON on stdout.
    """
    from aggregator.calibration.learning import learning_of
    from aggregator.calibration.load import singles_ticket
    from aggregator.calibration.single import read_weights, tuber_half_width
    from tuberline.cli.calibration_told import after_ticket, as_json

    rows, scale_g = read_weights(weights)
    ticket, laid, tubers = singles_ticket(
        run_dir,
        run=options.run,
        part=weighed.part(),
        scale_g=scale_g,
        scale_sd_g=scale_error_g,
        cultivar=options.cultivar,
        stated_offset_mm=options.resting_offset_mm,
    )
    known = options.add(ticket)
    learning = learning_of(tubers)
    left_rows = [rows[i] for i in laid.weights_left_out]
    left_tubers = [tubers[j].tuber_id for j in laid.tubers_left_out]
    half_width = tuber_half_width(known, ticket)
    if json:
        told = {
            **as_json(known, ticket, learning),
            "left_out": {"rows": left_rows, "tubers": left_tubers},
            "single_tuber_half_width": half_width,
        }
        sys.stdout.write(json_module.dumps(told, indent=2) + "\n")
        return
    sys.stdout.write(f"{len(laid.pairs)} of {len(scale_g)} weights laid beside {len(tubers)} tubers\n")
    for what, names in (("weights without a tuber, rows", left_rows), ("tubers without a weight, ids", left_tubers)):
        if names:
            sys.stdout.write(f"left out: {what} {', '.join(map(str, names))}\n")
    sys.stdout.write(after_ticket(known, ticket, options.tickets, learning))
    sys.stdout.write(
        f"a single tuber is then known to {100 * half_width:.0f} % (holds for 9 of 10, nine calibrations in ten)\n"
        if half_width is not None
        else "22 and more single weights also say how well a single tuber is known\n"
    )
