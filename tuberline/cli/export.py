"""`tuberline export`: what a run came to, as files that other programs open."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter


def export(
    runs: Annotated[list[Path], Parameter(name="runs", show_default=False)],
    /,
    *,
    format: Literal["csv", "parquet", "geojson", "geoparquet", "isoxml", "xlsx"],
    what: Literal["tubers", "loads", "cells"] = "tubers",
    out: Path | None = None,
    track: Annotated[list[Path] | None, Parameter(consume_multiple=True)] = None,
    width_m: float | None = None,
    overlap_m: float | None = None,
    delay_s: float | None = None,
    cell_m: float = 10.0,
    track_shift_s: float = 0.0,
) -> None:
    """Write tubers, loads or cells of the map for other programs, with units, calibration, coverage and version.

    Where positions are known (positions.csv beside the ledger, or --track) each tuber has the place where it grew.
    ISOXML is TASKDATA with a time log, one record per second.

    Parameters
    ----------
    runs
        Folders of runs (with their ledger.db), or ledgers.
    format
        csv has its units in NAME.csv-metadata.json (CSV on the Web); all others hold theirs.
    what
        Rows of the file: one per tuber, per load, or per cell of the field's map.
    out
        File to write; default: named after what and format, beside the first ledger.
    track
        Positions of each run, in their order: CSV, NMEA or GPX.
    width_m
        Working width, metres; default: [gnss] of the line's config.
    overlap_m
        By how much a pass is meant to overlap the one before, metres.
    delay_s
        From ground to camera, seconds; default: found from the yields.
    cell_m
        Side of a cell, metres.
    track_shift_s
        Added to the track's times, where its clock differs from the cameras'.
    """
    from aggregator.ledger.reader import ledger_file
    from conveyor.formats.positions import POSITIONS_FILE
    from tuberline.export.write import ENDINGS, Format
    from tuberline.export.write import export as write

    form = Format(format)
    field = None
    known = all((ledger_file(run).parent / POSITIONS_FILE).is_file() for run in runs)
    if what != "loads" and (track or known):
        from tuberline.maps.field import field_map
        from tuberline.maps.settings import settings_of

        settings = settings_of(
            runs,
            width_m=width_m,
            overlap_m=overlap_m,
            delay_s=delay_s,
            antenna_ahead_m=None,
            cell_m=cell_m,
            track_shift_s=track_shift_s,
        )
        field = field_map(runs, track or [], settings)
    name = "taskdata" if form is Format.ISOXML else what
    target = out or ledger_file(runs[0]).parent / f"{name}.{ENDINGS.get(form, form.value)}"
    rows = write(runs, target, form=form, what=what, field=field)
    sys.stdout.write(f"{rows} {'records' if form is Format.ISOXML else what} in {target}\n")
