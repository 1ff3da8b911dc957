"""`tuberline ledger totals`: what loads, fields, varieties, days and seasons come to."""

from __future__ import annotations

import json as json_module
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from aggregator.ledger.totals_by import Total


def totals(
    *paths: Path,
    by: Literal["load", "field", "variety", "day", "season"] = "load",
    tickets: Path | None = None,
    json: bool = False,
) -> None:
    """Print what the loads of one or many ledgers come to, raw and calibrated, with 90 % intervals.

    What loads have in common (the resting level, the camera, a variety's factor) is one error in all of them: the
    interval of a sum does not shrink as if each load were weighed by another line. Tickets of these loads calibrate
    the loads of their own line, and those that the line.toml beside a ledger names that ledger. A run that was cut off,
    or repaired with losses, is named: its loads may hold less than passed.

    Parameters
    ----------
    paths
        Folders of runs (with their ledger.db), or the ledgers themselves.
    by
        What to add up: loads one by one, or by their field, variety, day or season (the year).
    tickets
        A file of tickets beside these, as `tuberline calibrate` keeps it: they calibrate all of the loads.
    json
        For machines; in grams, null where no belt was seen.
    """
    from aggregator.calibration.tickets import read_tickets
    from aggregator.ledger.totals_by import all_loads, sums_by
    from conveyor.errors import InputError
    from tuberline.cli.progress import ledger_bar

    if not paths:
        raise InputError("name the folders of the runs whose loads are to be added up")
    with ledger_bar():
        found = all_loads(paths, tickets=read_tickets(tickets) if tickets else ())
        sums = sums_by(found.loads, by)
    if json:
        values = {
            "by": by,
            "totals": [_plain(total) for total in sums],
            "tickets_refused": found.refused,
            "tickets_doubted": found.doubts,
        }
        sys.stdout.write(json_module.dumps(values, indent=2) + "\n")
        return
    refused = [f"a ticket does not calibrate: {words}" for words in found.refused]
    print_totals(sums, [*refused, *found.doubts], by)


def _plain(total: Total) -> dict[str, Any]:
    """As values of JSON; without a weight where no belt was seen, which is not one of 0 g."""
    values = asdict(total)
    if not total.sums.saw:
        values["raw_g"] = None
        values["sums"] |= dict.fromkeys(name for name in values["sums"] if name.endswith("_g"))
    return values


def print_totals(found: list[Total], remarks: list[str], by: str) -> None:
    """One row a label, in 80 columns; below them what the interval of all is made of, `remarks`, and those of all."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from tuberline.cli.load_table import weight_told

    console = Console()
    heads = (by, "loads", "tubers", "raw kg", "kg\n(90 %)", "seen", "on scales\nkg")
    table = Table(*heads, box=None, pad_edge=False, collapse_padding=True)
    # Nothing is cut, what is too wide goes on below: two days that are cut look alike.
    for column in table.columns:
        column.overflow = "fold"
    for column in table.columns[1:4]:
        column.no_wrap = True
    table.columns[0].min_width, table.columns[5].min_width = len("2026-11-27"), len("100.0 %")
    for total in found:
        sums = total.sums
        scales = f"{total.net_g / 1000:.1f}\n({total.weighed} of {total.loads})" if total.weighed else "-"
        table.add_row(
            Text(total.label),
            str(total.loads) if total.loads else "-",  # what passed without one
            str(sums.tubers),
            # No weight where no belt was seen, which is not one of 0 kg.
            f"{total.raw_g / 1000:.2f}" if sums.saw else "-",
            weight_told(sums.estimated_g, sums.low_g, sums.high_g) if sums.saw else "-",
            "-" if sums.coverage is None else f"{100 * sums.coverage:.1f} %",
            scales,
        )
    console.print(table)
    if found and found[-1].sums.parts_percent:
        parts = ", ".join(f"{name} {part:.1f} %" for name, part in found[-1].sums.parts_percent.items())
        console.print(f"the 90 % interval of all is made of: {parts}", highlight=False)
    for words in (*remarks, *(found[-1].remarks if found else ())):
        console.print(Text(words))
