"""`tuberline sync`: ledgers of a fleet into one PostgreSQL."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def sync(
    database: str,
    runs: Annotated[list[Path], Parameter(name="runs", show_default=False)],
    /,
    *,
    every_s: float | None = None,
) -> None:
    """Bring committed tubers and loads of ledgers into a PostgreSQL; nothing is lost or double, whatever is cut.

    A second sync brings what is new. Totals are in the views tuberline.totals_by_field, _variety, _day and _line.

    Parameters
    ----------
    database
        postgresql://user@host/database; a password comes from PGPASSWORD or ~/.pgpass, never from here.
    runs
        Folders of runs (with their ledger.db), or ledgers, also of lines that run.
    every_s
        Go on, a sync every so many seconds, and wait for a database that is away; default: once.
    """
    from conveyor.errors import InputError, LinkError
    from tuberline.cli.progress import ledger_bar
    from tuberline.sync.push import connect, push

    if every_s is not None and not 1 <= every_s <= 86400:
        raise InputError(f"--every-s is {every_s:g}; allowed are 1 to 86400 s")
    while True:
        try:
            with connect(database) as connection:
                for run in runs:
                    with ledger_bar(str(run)):
                        done = push(connection, run)
                    sys.stdout.write(f"{run}: {done.tubers} new tubers of {done.runs} runs, {done.loads} loads\n")
                    sys.stdout.flush()
        except LinkError as error:
            if every_s is None:
                raise
            sys.stderr.write(f"tuberline: {error}; tried again in {every_s:g} s\n")
        if every_s is None:
            return
        time.sleep(every_s)
