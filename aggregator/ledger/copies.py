"""Ledgers that are read together and hold one run: a folder was copied, or a recording was replayed twice, and its
tubers would count twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from aggregator.ledger.load_totals import ReadLoads
from conveyor.errors import LedgerError


def refuse_copies(ledgers: Sequence[ReadLoads]) -> None:
    """Refuse ledgers of which two hold the same run: it has the same name and began with the same frames and tuber.

    Which of them is to count is the user's to say: one may lack tubers that came after it was copied, the other a
    ticket that was entered since.

    Raises:
        LedgerError: two hold one run; the text names both, with what each holds of it.
    """
    named: dict[str, list[ReadLoads]] = {}
    for ledger in ledgers:
        for run in ledger.runs:
            others = named.setdefault(run, [])
            for other in others:
                if (began := _beginning(ledger, run)) is not None and began == _beginning(other, run):
                    raise LedgerError(_told(run, other, ledger))
            others.append(ledger)


def _beginning(ledger: ReadLoads, run: str) -> Any:
    """When each camera saw its first frame and the first tuber passed; None without a tuber, which counts nothing."""
    tuber = ledger.first_tuber(run)
    frames = {camera: sight.first_ns for camera, sight in ledger.seen[run].sights.items()}
    return None if tuber is None else (frames, tuber.crossed_ns)


def _told(run: str, *ledgers: ReadLoads) -> str:
    one, other = (f"{ledger.path} ({ledger.sums(run).load.count} tubers)" for ledger in ledgers)
    return f"{one} and {other} both hold run '{run}', whose tubers would count twice: name one of the two"
