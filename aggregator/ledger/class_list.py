"""A run and its loads by the classes of a contract, as plain values."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from aggregator.core.class_totals import class_totals
from aggregator.core.totals import LoadTotals
from aggregator.ledger.load_list import told_loads
from aggregator.ledger.reader import read_sums, the_run
from aggregator.ledger.verified import LedgerView
from conveyor.contract import Contract
from conveyor.messages.base import plain


def told_classes(view: LedgerView, path: Path, contract: Contract, *, run: str | None = None) -> list[dict[str, Any]]:
    """Name and classes of the run, as weighed, and of each of its loads, as its tickets calibrate it.

    Raises:
        LedgerError: no such run, or several to choose from.
    """
    chosen = the_run(view, path, run)
    own = class_totals(LoadTotals(read_sums(view, chosen.run).load), contract)
    loads = [load for load in told_loads(view, limit=10**6, contract=contract) if load["run"] == chosen.run]
    return [
        {"name": f"run {chosen.run}", "classes": plain(own)},
        *({"name": f"load {load['number']} {load['name']}", "classes": load["classes"]} for load in loads),
    ]
