"""Ledgers that are read together and hold one run: a folder was copied, and its tubers would count twice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from aggregator.ledger.load_totals import ReadLoads
from aggregator.ledger.reader import RunRow
from conveyor.errors import LedgerError


def refuse_copies(ledgers: Sequence[ReadLoads]) -> None:
    """Refuse ledgers of which two hold the same run, which both began with the same row and the same entries.

    Which of them is to count is the user's to say: one may lack tubers that came after it was copied, the other tickets
    that were entered since.

    Raises:
        LedgerError: two hold one run; the text names both, with what each holds of it.
    """
    begun: dict[RunRow, list[ReadLoads]] = {}
    for ledger in ledgers:
        for run in ledger.runs.values():
            others = begun.setdefault(replace(run, finished=False), [])  # one may have been copied before its end
            if others and (first := ledger.first_entries(run)):
                for other in others:
                    if other.first_entries(run) == first:
                        raise LedgerError(_told(run.run, other, ledger))
            others.append(ledger)


def _told(run: str, *ledgers: ReadLoads) -> str:
    one, other = (f"{ledger.path} ({ledger.sums(run).load.count} tubers)" for ledger in ledgers)
    return f"{one} and {other} both hold run '{run}': one is a copy, and its tubers would count twice; name one of them"
