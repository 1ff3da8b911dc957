"""How a run ended: one word for the page, the audit and reports."""

from __future__ import annotations

from typing import Literal

from aggregator.ledger.reader import RunRow, read_sums
from aggregator.ledger.stated import summary_told
from aggregator.ledger.verified import LedgerView

End = Literal["cameras ended", "stopped", "goes on", "cut off"]
"""Its cameras ended, its line was stopped, a line writes it now, or it was cut off: its aggregator left no word. What
was stopped or cut off may go on later."""


def end_of(view: LedgerView, run: RunRow, written: str | None) -> End:
    """How `run` ended; `written` as by `run_being_written`.

    In an older ledger a summary beside it alone says of a run without an end that it was stopped.
    """
    if run.finished:
        return "cameras ended"
    if run.run == written:
        return "goes on"
    return "stopped" if read_sums(view, run.run).stopped or summary_told(view, run.run) else "cut off"
