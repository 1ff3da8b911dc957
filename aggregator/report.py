"""Totals, summary and table of a run, kept up to date as tubers are committed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from aggregator.calibration.tickets import read_tickets
from aggregator.core.coverage import Looked, camera_shares, combined_coverage
from aggregator.core.machine import Aggregation
from aggregator.core.totals import LoadTotals
from aggregator.ledger.audit import audit_run
from aggregator.ledger.files import tubers_csv, write_whole
from aggregator.ledger.writer import Ledger
from aggregator.summary import summarise, tally
from conveyor import __version__
from conveyor.config import LineConfig
from conveyor.counters import CounterSet
from conveyor.errors import LedgerError
from conveyor.messages import Totals, Tuber

TABLE_IN_HASTE = 20_000
"""Rows of tubers.csv that are written within the time a process has to stop."""


class Reporter:
    """What is told about a run; begins with the tubers that the ledger holds already."""

    def __init__(self, ledger: Ledger, core: Aggregation, *, config: LineConfig, counters: CounterSet) -> None:
        self._ledger = ledger
        self._core = core
        self._config = config
        self._counters = counters
        settings = config.aggregator
        self._load = LoadTotals(
            settings.histogram_step_g,
            read_tickets(settings.tickets) if settings.tickets else (),
            cultivar=settings.cultivar,
        )
        for tuber in ledger.tubers(core.run):
            self._load.add(tuber)

    def add(self, tuber: Tuber) -> None:
        """A tuber was committed."""
        self._load.add(tuber)

    def camera_coverage(self) -> dict[str, float | None]:
        """Share of the belt each camera looked at."""
        states = self._core.cameras.states
        return camera_shares(
            {
                name: Looked(state.mark.looked_at_m, state.mark.travelled_m) if state.mark else None
                for name, state in states.items()
            }
        )

    def totals(self, now_s: float) -> Totals:
        """The totals as they are now."""
        coverage = combined_coverage(self.camera_coverage(), seen_by=self._load.seen_by)
        return self._load.message(
            self._core.run,
            coverage=coverage,
            cameras=self._core.cameras.says(now_s),
            final=self._core.finished,
        )

    def summary(self, now_s: float) -> dict[str, Any]:
        """The summary as plain values, from the ledger and this process's counters."""
        run = self._ledger.run_row(self._core.run)
        if run is None:
            raise LedgerError(f"run '{self._core.run}' is not in ledger {self._ledger.path}")
        models, methods = tally(self._ledger.connection, self._core.run)
        return summarise(
            self.totals(now_s),
            line=self._config.name,
            version=__version__,
            audit=audit_run(self._ledger.connection, run),
            camera_coverage=self.camera_coverage(),
            counters=self._counters.snapshot()[0],
            models=models,
            methods=methods,
            tubers={"committed": self._load.count, "merged": self._load.merged, "late": self._load.late},
        )

    def summary_text(self, now_s: float) -> str:
        """The summary as JSON."""
        return json.dumps(self.summary(now_s), indent=2) + "\n"

    def write(self, folder: Path, now_s: float, *, in_haste: bool = False) -> bool:
        """Write tubers.csv and summary.json into `folder`; the summary last, so that it never stands alone.

        `in_haste`: a process that was told to stop leaves a long table out. Returns whether the table was written.
        """
        table = not in_haste or self._load.count <= TABLE_IN_HASTE
        if table:
            write_whole(folder / "tubers.csv", tubers_csv(self._ledger.tubers(self._core.run)))
        write_whole(folder / "summary.json", self.summary_text(now_s))
        return table

    def headline(self, now_s: float) -> str:
        """One line for the log."""
        totals = self.totals(now_s)
        seen = "unknown" if totals.coverage is None else f"{100 * totals.coverage:.1f} %"
        return (
            f"{totals.count} tubers, {totals.weight_g / 1000:.3f} kg "
            f"({totals.low_g / 1000:.3f} to {totals.high_g / 1000:.3f}), belt seen {seen}, "
            f"calibrated by {totals.calibrated_by or 'nothing'}, final={totals.final}"
        )
