"""Run the whole line on a recording; read what a run left."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from aggregator.ledger.reader import ledger_file, read_summary, read_tubers, reading, the_run
from aggregator.ledger.totals_by import Total, totals_by
from conveyor.messages import (
    CameraExchanged,
    CamerasApart,
    ClassTotal,
    ForeignTotal,
    HeightChange,
    LoadNow,
    Totals,
    Tuber,
)
from conveyor.messages.base import plain
from tuberline.api.values import by_parameters, in_range

REGRESSORS = (1, 64)


@dataclass(frozen=True, slots=True)
class Ledger:
    """One run as its ledger has it.

    Attributes:
        path: the ledger, an SQLite file.
        run: id of the run.
        line: name of the line.
        cameras: names of its cameras.
        tubers: every tuber once, by tuber_id, each with weight_g, low_g, high_g (grams), place_x_m, place_y_m (metres
            on the belt), length_mm, width_mm, height_mm, views, method, model, flags, cameras and crossed_ns.
        totals: of the finished run: count, weight_g, low_g, high_g, coverage (share of the belt looked at),
            estimated_weight_g and so on; None while the run goes on, or where it was cut off.
        summary: all that summary.json says; None like `totals`.
    """

    path: Path
    run: str
    line: str
    cameras: tuple[str, ...]
    tubers: tuple[Tuber, ...]
    totals: Totals | None
    summary: dict[str, Any] | None

    def as_dicts(self) -> list[dict[str, Any]]:
        """The tubers as plain values, e.g. for pandas.DataFrame."""
        return [plain(tuber) for tuber in self.tubers]


@by_parameters
def replay(
    recording: str | Path,
    *,
    out: str | Path,
    speed: float = 0.0,
    regressors: int | None = None,
    weights: str | Path | None = None,
    ignore_masks: bool = False,
    resting_offset_mm: float | None = None,
    places: str | Path | None = None,
    fast: bool = False,
) -> Ledger:
    """Count and weigh everything in a recording, with all processes of a real line on this machine.

    Args:
        recording: of any known format; all its cameras are used.
        out: folder for ledger.db, summary.json and tubers.csv; must not hold a run yet.
        speed: times real time; 0 as fast as the line takes it. Nothing is lost at any speed.
        regressors: number of weighing processes, 1 to 64; None: two, or one on a single processor.
        weights: a .safetensors or the authors' .pth; None takes the shipped ones.
        resting_offset_mm: how far tubers' undersides lie below the belt; None: what the recording states.
        ignore_masks: find the tubers on depth though the recording has masks of its own.
        places: a line's file that says where the cameras hang, as `tuberline calibrate cameras` prints it, and in
            `[belt]` what tubers lie on; None: what the recording says.
        fast: weigh one view of a tuber from each camera, in the fastest form within 0.1 g of the exact one.

    Returns:
        The ledger of the run.

    Raises:
        TuberlineError: recording or weights unusable, `out` holds a run already, or a process gave up; the text has
            its last words.
    """
    from tuberline.replayer import replay_recording

    if regressors is not None:
        in_range("regressors", regressors, REGRESSORS, whole=True)
    replay_recording(
        Path(recording),
        out=Path(out),
        speed=speed,
        regressors=int(regressors) if regressors is not None else None,
        weights=Path(weights) if weights is not None else None,
        ignore_masks=ignore_masks,
        resting_offset_mm=resting_offset_mm,
        places=Path(places) if places is not None else None,
        fast=fast,
    )
    return read_ledger(out)


def read_ledger(path: str | Path, *, run: str | None = None) -> Ledger:
    """Read a run's ledger; also while it is being written.

    Args:
        path: folder of the run (with its ledger.db), or the ledger itself.
        run: which run, where the ledger holds several.

    Raises:
        TuberlineError: no ledger, a damaged one, one of another version, or several runs to choose from.
    """
    file = ledger_file(Path(path))
    with reading(file) as db:
        chosen = the_run(db, file, run)
        tubers = tuple(read_tubers(db, chosen.run))
        told = read_summary(db, chosen.run)
    summary: dict[str, Any] | None = json.loads(told) if told else None
    return Ledger(
        path=file,
        run=chosen.run,
        line=chosen.line,
        cameras=chosen.cameras,
        tubers=tubers,
        totals=_totals(summary["totals"]) if summary else None,
        summary=summary,
    )


def read_totals(
    *paths: str | Path, by: Literal["load", "field", "variety", "day", "season"] = "load"
) -> tuple[Total, ...]:
    """What the loads of one or many ledgers come to, calibrated by their own tickets and those that their lines name.

    Args:
        paths: folders of runs (with their ledger.db), or the ledgers themselves; also while they are being written.
        by: what to add up: loads one by one, or by their field, variety, day or season.

    Returns:
        One total per label, and the sum of all, 'all', last. A run in which no load was started is one load by itself.
        `remarks` of each say which of its runs were cut off or repaired with losses.

    Raises:
        TuberlineError: no ledger, a damaged one, or one of another version.
    """
    found, _ = totals_by([Path(path) for path in paths], by)
    return tuple(found)


def _totals(values: dict[str, Any]) -> Totals:
    load = values.get("load")
    heights = tuple(HeightChange(**each) for each in (load or {}).get("heights", ()))
    loads = {"load": LoadNow(**{**load, **_parts(load), "heights": heights})} if load else {}
    apart = tuple(CamerasApart(**each) for each in values.get("apart", ()))
    exchanged = tuple(CameraExchanged(**each) for each in values.get("exchanged", ()))
    more = {**loads, **_parts(values), "apart": apart, "exchanged": exchanged}
    return Totals(**{**values, "histogram": tuple(values["histogram"]), **more})


def _parts(values: dict[str, Any]) -> dict[str, Any]:
    """Classes and foreign matter of a load as messages."""
    foreign = values.get("foreign")
    return {
        "classes": tuple(ClassTotal(**each) for each in values.get("classes", ())),
        "foreign": ForeignTotal(**foreign) if foreign else None,
    }
