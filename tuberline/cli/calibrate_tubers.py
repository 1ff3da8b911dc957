"""`tuberline calibrate tubers`: single weights of tubers that passed the line, in belt order."""

from __future__ import annotations

import json as json_module
import sys
from pathlib import Path


def calibrate_tubers(
    run_dir: Path,
    weights: Path,
    /,
    *,
    tickets: Path = Path("tickets.json"),
    scale_error_g: float = 1.0,
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
    """Calibrate by single weights: they tell an offset in millimetres from a factor, which one sum cannot.

    A tuber that was not weighed, or a weight without a tuber, is found and left out.

    Parameters
    ----------
    run_dir
        Folder of the counted run (with its ledger.db), or the ledger itself.
    weights
        CSV file, one tuber a row in the order of the belt; grams in the column weight_g, or in the only column.
    tickets
        File of tickets; made where it does not exist. Name it as aggregator.tickets in the line's file.
    scale_error_g
        Standard deviation of the scale.
    first, last
        Ids of the first and last tuber that was weighed, where it is a part of the run (see tubers.csv).
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
    from aggregator.calibration.load import Part, singles_ticket
    from aggregator.calibration.single import read_weights, tuber_half_width
    from tuberline.cli.calibration_told import add_ticket, after_ticket, as_json

    rows, scale_g = read_weights(weights)
    ticket, laid, tubers = singles_ticket(
        run_dir,
        run=run,
        part=Part(first, last, from_x, to_x),
        scale_g=scale_g,
        scale_sd_g=scale_error_g,
        cultivar=cultivar,
        stated_offset_mm=resting_offset_mm,
    )
    known = add_ticket(tickets, ticket, again=again)
    left_rows = [rows[i] for i in laid.weights_left_out]
    left_tubers = [tubers[j].tuber_id for j in laid.tubers_left_out]
    half_width = tuber_half_width(known, ticket)
    if json:
        told = {
            **as_json(known, ticket),
            "left_out": {"rows": left_rows, "tubers": left_tubers},
            "single_tuber_half_width": half_width,
        }
        sys.stdout.write(json_module.dumps(told, indent=2) + "\n")
        return
    sys.stdout.write(f"{len(laid.pairs)} of {len(scale_g)} weights laid beside {len(tubers)} tubers\n")
    for what, names in (("weights without a tuber, rows", left_rows), ("tubers without a weight, ids", left_tubers)):
        if names:
            sys.stdout.write(f"left out: {what} {', '.join(map(str, names))}\n")
    sys.stdout.write(after_ticket(known, ticket, tickets))
    sys.stdout.write(
        f"a single tuber is then known to {100 * half_width:.0f} % (holds for 9 of 10, nine calibrations in ten)\n"
        if half_width is not None
        else "22 and more single weights also say how well a single tuber is known\n"
    )
