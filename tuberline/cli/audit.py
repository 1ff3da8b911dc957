"""`tuberline audit`: the balance sheet of a run."""

from __future__ import annotations

import json as json_module
import sys
from pathlib import Path


def audit(run_dir: Path, /, *, run: str | None = None, json: bool = False) -> None:
    """Print the balance sheet of a finished or a running line; exit with 1 if an equation does not hold.

    Parameters
    ----------
    run_dir
        Folder of a run (with its ledger.db), or the ledger itself.
    run
        Which run, where the ledger holds several.
    json
        Print the balance sheet as JSON on stdout.
    """
    from aggregator.ledger.audit import audit_run
    from aggregator.ledger.reader import ledger_file, reading, the_run
    from tuberline.cli.progress import ledger_bar

    path = ledger_file(run_dir)
    with ledger_bar(), reading(path) as db:
        found = audit_run(db, the_run(db, path, run))
    if json:
        sys.stdout.write(json_module.dumps(found.as_dict(), indent=2) + "\n")
    else:
        from rich.console import Console

        from tuberline.cli.ledger_tables import audit_table, camera_table

        console = Console()
        console.print(camera_table(found))
        console.print(audit_table(found))
        for fault in found.faults:
            console.print(f"damaged: {fault}", style="red", markup=False, highlight=False)
    if not found.balanced:
        sys.exit(1)
