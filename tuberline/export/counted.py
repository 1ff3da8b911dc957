"""The tubers of ledgers, read row by row as often as they are asked for, and not held in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from aggregator.ledger.load_totals import ReadLoads
from aggregator.ledger.reader import LedgerView, all_runs, ledger_file, read_tubers, reading
from aggregator.ledger.totals_by import labelled
from conveyor.messages import Tuber


class LedgerTubers:
    """All tubers of one ledger at the moment of its view, of all of its runs one after the other.

    Each pass reads them again; all passes give the same ones, also while a line writes more.
    """

    def __init__(self, view: LedgerView, runs: Sequence[str], wanted: Callable[[Tuber], bool] | None = None) -> None:
        """`wanted`: which of them; None: all."""
        self._view = view
        self._runs = runs
        self._wanted = wanted

    def __iter__(self) -> Iterator[Tuber]:
        tubers = (tuber for run in self._runs for tuber in read_tubers(self._view, run))
        return tubers if self._wanted is None else filter(self._wanted, tubers)


@contextmanager
def counted(runs: Sequence[Path]) -> Iterator[list[LedgerTubers]]:
    """The tubers of each ledger, to be read within the block.

    Raises:
        LedgerError: no ledger, of another version, or unreadable.
    """
    with ExitStack() as stack:
        found = []
        for path in runs:
            view = stack.enter_context(reading(file := ledger_file(path)))
            found.append(LedgerTubers(view, [run.run for run in all_runs(view, file)]))
        yield found


@contextmanager
def counted_on(runs: Sequence[Path], day: str) -> Iterator[list[LedgerTubers]]:
    """Those of each ledger whose load began on `day` (YYYY-MM-DD), of a run without loads those of one of that day.

    Raises:
        LedgerError: no ledger, of another version, or unreadable.
    """
    with ExitStack() as stack:
        yield [_of_day(stack.enter_context(reading(file)), file, day) for file in map(ledger_file, runs)]


def _of_day(view: LedgerView, file: Path, day: str) -> LedgerTubers:
    ledger = ReadLoads(view)
    days = {load.load.number if load.load else load.run: load.labels["day"] for load in labelled(ledger, ())}
    runs = [run.run for run in all_runs(view, file)]
    return LedgerTubers(view, runs, lambda tuber: days.get(ledger.load_of(tuber) or tuber.run) == day)
