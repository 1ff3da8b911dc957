"""The last runs of a ledger: one line each, for who asks over the link."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from aggregator.calibration.tickets import Ticket
from aggregator.calibration.together import together
from aggregator.ledger.ends import end_of
from aggregator.ledger.line_tickets import tickets_beside
from aggregator.ledger.load_totals import ReadLoads
from aggregator.ledger.reader import RunRow, read_runs, run_being_written
from aggregator.ledger.stated import summary_told
from aggregator.ledger.totals_by import run_loads
from aggregator.ledger.verified import LedgerView


def last_loads(view: LedgerView, *, limit: int) -> list[dict[str, Any]]:
    """Runs of a ledger, the newest first: when begun, what they came to, and how they ended (`ends.End`).

    `weight_g` is that of what was seen, with its 90 % interval `low_g` to `high_g`; None where nothing was seen. It is
    what `ledger totals` makes of the run now: a ticket may have come after the summary of one that has ended.
    """
    newest, written = read_runs(view)[::-1][:limit], run_being_written(view)
    ledger = ReadLoads(view)
    tickets = tickets_beside(ledger)
    found = []
    for known in newest:
        sums = ledger.sums(known.run)
        summary = summary_told(view, known.run, sums)
        end = end_of(known, written, sums=sums, summary=summary)
        begun = {"run": known.run, "started_unix_s": known.started_ns / 1e9}
        final = known.finished and bool(summary["totals"]["final"])
        found.append({**begun, "end": end, **_came_to(ledger, known, tickets), "final": final})
    return found


def _came_to(ledger: ReadLoads, known: RunRow, tickets: Sequence[Ticket]) -> dict[str, Any]:
    sums = together(run_loads(ledger, known, tickets))
    low_g, high_g = sums.seen_g if sums.saw else (None, None)
    grams = {"weight_g": sums.weight_g if sums.saw else None, "low_g": low_g, "high_g": high_g}
    return {"count": sums.tubers, **grams, "coverage": sums.coverage}
