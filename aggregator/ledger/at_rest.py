"""Orders about loads of a ledger that no line is writing: notes and tickets, which often come in the evening."""

from __future__ import annotations

import time
from pathlib import Path

from aggregator.calibration.tickets import Ticket
from aggregator.core.load_orders import answer, decide, refusal
from aggregator.core.loads import LoadEvent
from aggregator.ledger.line_tickets import with_own
from aggregator.ledger.load_totals import Seen, tickets_of
from aggregator.ledger.receipt import is_being_written
from aggregator.ledger.stated import stated_beside
from aggregator.ledger.ticket_doubts import ticket_remark
from aggregator.ledger.writer import Ledger
from conveyor.errors import InputError, StorageError
from conveyor.load_orders import check_order
from conveyor.messages import LoadAnswer, LoadOrder


def order_at_rest(path: Path, order: LoadOrder) -> LoadAnswer:
    """Carry out `order` in the ledger at `path`, durably.

    Raises:
        InputError: no ledger there, or an order that no line would take.
        LedgerError: damaged, or being written by a line: ask that line instead.
    """
    check_order(order)
    if not path.is_file():
        raise InputError(f"there is no ledger at {path}; give a run's folder or its ledger.db")
    if is_being_written(path):
        raise StorageError(f"ledger {path} is being written by a line: give the order to that line, without --ledger")
    if order.action in ("start", "end", "undo"):
        return refusal(
            order, InputError("a load starts, ends or is undone while its line runs; without it, notes and tickets")
        )
    with Ledger(path) as ledger:
        runs = ledger.runs()
        if not runs:
            return refusal(order, InputError(f"ledger {path} holds no run"))
        try:
            event = decide(
                order, ledger.loads, run=runs[-1].run, now_ns=time.time_ns(), line={}, place_x_m=lambda order: 0.0
            )
        except InputError as error:
            return refusal(order, error)
        ledger.say(event)
        return answer(order, event, ledger.loads, remark=_remark(path, ledger, event))


def _remark(path: Path, ledger: Ledger, event: LoadEvent) -> str:
    """What is to be said of a ticket that was entered; all runs are over."""
    runs = dict.fromkeys(run for load in ledger.loads.loads.values() for run, _ in load.spans)
    seen = {row.run: Seen.at_rest(row, ledger.sums(row.run)) for row in ledger.runs() if row.run in runs}
    stated = stated_beside(path)

    def tickets() -> list[Ticket]:
        return with_own(stated.tickets, tickets_of(ledger, seen, cultivar=stated.cultivar)[0])

    return ticket_remark(ledger, event, seen, tickets, cultivar=stated.cultivar)
