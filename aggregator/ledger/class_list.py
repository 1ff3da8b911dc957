"""A run and its loads by the classes of a contract, as plain values."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from aggregator.core.class_totals import classes_together
from aggregator.ledger.line_tickets import tickets_beside
from aggregator.ledger.load_list import told_loads
from aggregator.ledger.load_totals import ReadLoads
from aggregator.ledger.reader import RunRow, the_run
from aggregator.ledger.totals_by import run_loads
from aggregator.ledger.verified import LedgerView
from conveyor.contract import Contract
from conveyor.messages import ClassTotal
from conveyor.messages.base import plain


def classes_of_run(ledger: ReadLoads, run: RunRow, contract: Contract) -> tuple[ClassTotal, ...]:
    """The classes of a run: of its loads together, each as its tickets calibrate it."""
    ones = run_loads(ledger, run, tickets_beside(ledger))
    return classes_together([one.totals for one in ones], contract, whole=[one.whole for one in ones])


def told_classes(view: LedgerView, path: Path, contract: Contract, *, run: str | None = None) -> list[dict[str, Any]]:
    """Name and classes of the run, and of each of its loads, as tickets calibrate them: as `totals_by` tells weights.

    Raises:
        LedgerError: no such run, or several to choose from.
    """
    chosen = the_run(view, path, run)
    own = classes_of_run(ReadLoads(view), chosen, contract)
    loads = [load for load in told_loads(view, limit=10**6, contract=contract) if load["run"] == chosen.run]
    return [
        {"name": f"run {chosen.run}", "classes": plain(own)},
        *({"name": f"load {load['number']} {load['name']}", "classes": load["classes"]} for load in loads),
    ]
