"""`tuberline export`: what a run came to, as files that other programs open."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from conveyor.errors import InputError
from tuberline.cli.numbers import TrackShift

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tuberline.export.counted import LedgerTubers
    from tuberline.export.write import Format
    from tuberline.maps.field import FieldPlaces


def export(
    runs: Annotated[list[Path], Parameter(name="runs", show_default=False)],
    /,
    *,
    format: Literal["csv", "parquet", "geojson", "geoparquet", "isoxml", "xlsx", "html", "pdf"],
    what: Literal["tubers", "loads", "cells"] = "tubers",
    out: Path | None = None,
    track: Annotated[list[Path] | None, Parameter(consume_multiple=True)] = None,
    width_m: float | None = None,
    overlap_m: float | None = None,
    delay_s: float | None = None,
    cell_m: float = 10.0,
    track_shift_s: TrackShift = 0.0,
    day: str | None = None,
    contract: Path | None = None,
) -> None:
    """Write tubers, loads or cells of the map for other programs, or a day's report for a person.

    All files tell units, calibration, coverage, weights and version.

    Where positions are known (positions.csv beside the ledger, or --track) each tuber has the place where it grew.
    ISOXML is TASKDATA with a time log, one record per second. html and pdf are the report: loads, sizes, foreign
    matter, map, what went wrong.

    Parameters
    ----------
    runs
        Folders of runs (with their ledger.db), or ledgers.
    format
        csv has its units in NAME.csv-metadata.json (CSV on the Web); all others hold theirs.
    what
        Rows of the file: one per tuber, per load, or per cell of the field's map. A report has all it needs.
    out
        File to write; default: named after what and format, beside the first ledger (tubers as csv:
        exported-tubers.csv, for tubers.csv is the run's own).
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
    day
        Of the report, YYYY-MM-DD; default: all that the runs hold.
    contract
        Of the report: a buyer's classes of size (TOML); default: that of the line's config.
    """
    from tuberline.cli.progress import ledger_bar
    from tuberline.cli.run_files import each_once, output
    from tuberline.export.counted import counted
    from tuberline.export.write import ENDINGS, NEED_PLACES, REPORTS, Format
    from tuberline.export.write import export as write

    form = Format(format)
    _check(form, what=what, track=track, day=day, contract=contract)
    name = "report" if form in REPORTS else "taskdata" if form is Format.ISOXML else what
    runs, tracks = each_once(runs, track or [])
    target = output(runs, f"{name}.{ENDINGS.get(form, form.value)}", out, read=(*tracks, contract))
    _check_name(form, out)
    how = {"width_m": width_m, "overlap_m": overlap_m, "delay_s": delay_s, "antenna_ahead_m": None}
    places_alone = what == "tubers" and form not in (*REPORTS, Format.ISOXML)
    settings = {**how, "cell_m": cell_m, "track_shift_s": track_shift_s, "places_alone": places_alone}
    # Of one moment: places are found for the same tubers as the rows have.
    with counted(runs if what == "tubers" and form not in REPORTS else ()) as tubers:
        field, no_map = None, ""
        if what != "loads":
            try:
                with ledger_bar("positions"):
                    mapped = what == "cells" or form in REPORTS
                    field = _field(runs, tracks, settings, tubers, mapped=mapped, day=day)
            except InputError as error:
                if tracks or form in NEED_PLACES or what == "cells":
                    raise
                no_map = str(error)  # positions were found, a map was not asked for
                if form not in REPORTS:  # which says why itself
                    sys.stderr.write(f"tubers without their places: {error}\n")
        if form in REPORTS:
            _report(runs, target, field, pdf=form is Format.PDF, no_map=no_map, day=day, contract=contract)
            return
        with ledger_bar(form.value):
            rows = write(runs, target, form=form, what=what, field=field, tubers=tubers)
    noun = "record" if form is Format.ISOXML else "row"
    written = f"{rows} {noun}{'s' * (rows != 1)}"
    sys.stdout.write(f"{written}{'' if form is Format.ISOXML else f' of {what}'} in {target}\n")


def _check(form: Format, *, what: str, track: list[Path] | None, day: str | None, contract: Path | None) -> None:
    """Refuse options of which one says what another does not let it be.

    Raises:
        InputError: some do; the text says which, and what to do.
    """
    from tuberline.export.write import REPORTS, Format

    if form in (*REPORTS, Format.ISOXML) and what != "tubers":
        raise InputError(f"--what {what} chooses the rows of a table; {form.value} has all it needs: leave it out")
    if form not in REPORTS and (day is not None or contract is not None):
        option = "--day" if day is not None else "--contract"
        raise InputError(f"{option} is of the report: give it with --format html or pdf; {form.value} holds all rows")
    if what == "loads" and track:
        raise InputError("--track places tubers and cells, loads have no place: leave it out, or choose --what tubers")


def _check_name(form: Format, out: Path | None) -> None:
    """Refuse a file that is named as another format than it would be.

    Raises:
        InputError: it is.
    """
    from tuberline.export.write import ENDINGS, Format

    named, ending = out.suffix.lower().removeprefix(".") if out else "", ENDINGS.get(form, form.value)
    if named != ending and named in {ENDINGS.get(each, each.value) for each in Format}:
        raise InputError(f"--out {out} is named as {named} and would be {form.value}: end its name in .{ending}")


def _report(
    runs: list[Path],
    target: Path,
    field: FieldPlaces | None,
    *,
    pdf: bool,
    no_map: str,
    day: str | None,
    contract: Path | None,
) -> None:
    from tuberline.cli.progress import ledger_bar
    from tuberline.export.report.make import write_report
    from tuberline.maps.field import FieldMap

    drawn = field if isinstance(field, FieldMap) else None
    with ledger_bar("report"):
        total = write_report(runs, target, pdf=pdf, field=drawn, no_map=no_map, day=day, contract=contract)
    loads = f"{total.loads} load{'s' * (total.loads != 1)}" if total.loads else ""
    rest = f"what passed without {'one' if loads else 'a load'}" if total.without_load else ""
    sys.stdout.write(f"report of {' and '.join(filter(None, (loads, rest)))} in {target}\n")


def _field(
    runs: list[Path],
    tracks: list[Path],
    how: dict[str, Any],
    tubers: Sequence[LedgerTubers],
    *,
    mapped: bool,
    day: str | None,
) -> FieldPlaces | None:
    """Where these runs were, as a map if `mapped`; None where their positions are not known. `day`: of it alone."""
    from aggregator.ledger.reader import ledger_file
    from conveyor.formats.positions import POSITIONS_FILE

    if not tracks and not any((ledger_file(run).parent / POSITIONS_FILE).is_file() for run in runs):
        return None
    from tuberline.export.counted import counted_on
    from tuberline.maps.field import check_tracks, field_map, field_places
    from tuberline.maps.settings import settings_of

    settings = settings_of(runs, **how)
    if not mapped:
        return field_places(runs, tracks, settings, tubers=tubers)
    if day is None:
        return field_map(runs, tracks, settings)
    check_tracks(runs, tracks)
    with counted_on(runs, day) as of_day:
        there = [n for n, found in enumerate(of_day) if next(iter(found), None) is not None]
        if not there:
            return None  # the report itself says which days there are
        return field_map(
            [runs[n] for n in there],
            [tracks[n] for n in there if tracks],
            [settings[n] for n in there],
            tubers=[of_day[n] for n in there],
        )
