"""Whether a line may go on with a run that its ledger holds."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from aggregator.ledger.reader import RunRow, read_run
from aggregator.ledger.verified import reading
from conveyor.errors import LedgerError


def check_goes_on(known: RunRow, path: Path, *, cameras: Sequence[str], may_be_finished: bool) -> None:
    """Refuse the run `known` of the ledger at `path` where it cannot go on.

    Args:
        cameras: those of the line, by name.
        may_be_finished: a finished run is none of the reasons: its entries are all duplicates.

    Raises:
        LedgerError: the run is finished, or was begun with other cameras.
    """
    if known.finished and not may_be_finished:
        raise LedgerError(
            f"ledger {path} already holds run '{known.run}', finished: counting it again would count every "
            "tuber twice; give another --run, or another aggregator.out"
        )
    if list(known.cameras) != sorted(cameras):
        raise LedgerError(
            f"run '{known.run}' in ledger {path} was begun with cameras {', '.join(known.cameras)}, the config "
            f"has {', '.join(sorted(cameras))}; fix the config or give another --run"
        )


def check_run_goes_on(path: Path, run: str, *, cameras: Sequence[str], may_be_finished: bool) -> None:
    """The same, before any process starts. A ledger that is not there, or cannot be read now, is left to who writes it.

    Raises:
        LedgerError: as `check_goes_on`.
    """
    known = None
    with suppress(LedgerError), reading(path) as view:
        known = read_run(view, run)
    if known is not None:
        check_goes_on(known, path, cameras=cameras, may_be_finished=may_be_finished)
