"""`tuberline sync`: ledgers of a fleet into one PostgreSQL."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter


def sync(
    database: str,
    runs: Annotated[list[Path], Parameter(name="runs", show_default=False)],
    /,
    *,
    every_s: float | None = None,
) -> None:
    """Bring committed tubers and loads of ledgers into a PostgreSQL; nothing is lost or double, whatever is cut.

    A second sync brings what is new. A ledger that cannot be read keeps no other back: it is named, and the exit code
    is 1. Totals are in the views tuberline.totals_by_field, _variety, _day and _line.

    Parameters
    ----------
    database
        postgresql://user@host/database; a password comes from PGPASSWORD or ~/.pgpass, never from here.
    runs
        Folders of runs (with their ledger.db), or ledgers, also of lines that run.
    every_s
        Go on, a sync every so many seconds, and wait for a database or a ledger that is away; default: once.
    """
    from conveyor.errors import InputError, LinkError, TuberlineError
    from tuberline.sync.push import connect

    if every_s is not None and not 1 <= every_s <= 86400:
        raise InputError(f"--every-s is {every_s:g}; allowed are 1 to 86400 s")
    again = "" if every_s is None else f"; tried again in {every_s:g} s"
    faults: dict[Path, str] = {}
    while True:
        try:
            with connect(database) as connection:
                for run in runs:
                    _sync_one(connection, run, faults, again)
        except LinkError as error:
            if every_s is None:
                raise
            sys.stderr.write(f"tuberline: {error}{again}\n")
        if every_s is None:
            break
        time.sleep(every_s)
    if faults:
        failed = TuberlineError(
            f"{len(faults)} of {len(runs)} ledgers were not synced: {', '.join(map(str, faults))}; "
            "what is wrong with each stands above"
        )
        failed.exit_code = 1
        raise failed


def _sync_one(connection: Any, run: Path, faults: dict[Path, str], again: str) -> None:
    """Bring one ledger and say so; what is wrong with it goes to `faults`, and is said where it was not there before.

    Raises:
        LinkError: the database went away; all others would fail by that, too.
    """
    from conveyor.errors import LinkError, TuberlineError
    from conveyor.files import told
    from tuberline.cli.progress import ledger_bar
    from tuberline.sync.push import push

    try:
        with ledger_bar(str(run)):
            done = push(connection, run)
    except LinkError:
        raise
    except (TuberlineError, OSError) as error:
        text = told(error, run) if isinstance(error, OSError) else str(error)
        if faults.get(run) != text:
            sys.stderr.write(f"tuberline: {text}{again}\n")
        faults[run] = text
        return
    faults.pop(run, None)
    sys.stdout.write(f"{run}: {done.tubers} new tubers of {done.runs} runs, {done.loads} loads\n")
    sys.stdout.flush()
