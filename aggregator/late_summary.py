"""The summary of a run whose aggregator was down when its line was stopped: written from the ledger alone."""

from __future__ import annotations

import time

from aggregator.ledger.writer import Ledger
from aggregator.opening import core_of, open_run
from aggregator.report import Reporter
from conveyor.config import LineConfig
from conveyor.counters import CounterSet


def write_late_summary(config: LineConfig, run: str, *, stopped_s: float | None = None) -> bool:
    """Write summary.json and tubers.csv of `run` into the line's folder of results; False where the ledger, or the run
    in it, was never begun.

    What the segmenters had logged and not delivered is not in it: that belt counts as not seen, and so does what ran
    under a live camera until the line was stopped. A run that goes on later writes its own summary.

    Args:
        stopped_s: when that was, seconds since 1970; None: not known.

    Raises:
        LedgerError: the ledger cannot be trusted, or an aggregator is at work on it.
    """
    out = config.aggregator.out
    path = out / "ledger.db"
    if not path.is_file():
        return False
    with Ledger(path) as ledger:
        row = ledger.run_row(run)
        if row is None:
            return False
        restored = open_run(ledger, run, config=config, cameras=row.cameras, may_be_finished=True)
        now_s = time.monotonic()
        core = core_of(ledger, run, restored, config=config, cameras=row.cameras, now_s=now_s)
        if stopped_s is not None:
            core.cameras.ran_until(round(stopped_s * 1e9), now_s)
        reporter = Reporter(ledger, core, config=config, counters=CounterSet())
        reporter.stopped()
        if not core.finished:
            ledger.stopped(run, reporter.at_rest(now_s))
        reporter.write(out, now_s)
        if core.finished:  # it was down between the last entry and its goodbye
            ledger.finish(run, reporter.summary_text(now_s), sights=core.cameras.sights)
    return True
