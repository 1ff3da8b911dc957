"""How a run ended: one word for the page, the audit and reports."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from aggregator.ledger.reader import RunRow
from aggregator.ledger.sums import RunSums

End = Literal["cameras ended", "stopped", "goes on", "cut off"]
"""Its cameras ended, its line was stopped, a line writes it now, or it was cut off: its aggregator left no word. What
was stopped or cut off may go on later."""


def end_of(run: RunRow, written: str | None, *, sums: RunSums, summary: Mapping[str, Any]) -> End:
    """How `run` ended, by its sums and its summary ({}: none); `written` as by `run_being_written`.

    In an older ledger a summary beside it alone says of a run without an end that it was stopped.
    """
    if run.finished:
        return "cameras ended"
    if run.run == written:
        return "goes on"
    return "stopped" if sums.stopped or summary else "cut off"


def less_than_all(run: str, end: End, *, lacks: bool) -> str:
    """In a sentence, why a run may hold less than passed; '' where nothing says so. `lacks`: as in `RunSums`."""
    if lacks:
        return (
            f"Run {run} was repaired with losses: its ledger holds less than it did. Tubers, weights and belt seen are "
            "of what is left."
        )
    if end == "cut off":
        return f"Run {run} was cut off: its aggregator ended without a word. This is what is committed."
    return ""
