"""`tuberline map`: the field's yield in t/ha."""

from __future__ import annotations

import json as json_module
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from conveyor.errors import InputError
from tuberline.cli.numbers import TrackShift


def map_field(
    runs: Annotated[list[Path], Parameter(name="runs", show_default=False)],
    /,
    *,
    track: Annotated[list[Path] | None, Parameter(consume_multiple=True)] = None,
    width_m: float | None = None,
    overlap_m: float | None = None,
    delay_s: float | None = None,
    antenna_ahead_m: float | None = None,
    cell_m: float = 10.0,
    track_shift_s: TrackShift = 0.0,
    raw: bool = False,
    smooth: bool = False,
    out: Path | None = None,
    title: str | None = None,
    json: bool = False,
) -> None:
    """Map a field's yield in t/ha from one or more runs and the machine's positions.

    Width, overlap, delay and antenna are those of [gnss] in the line.toml beside each ledger, where not given.
    Several machines in one field are brought to one scale. Points that are left out keep their reason (--json).

    Parameters
    ----------
    runs
        Folders of runs (with their ledger.db), or ledgers: all of one field.
    track
        Positions of each run, in their order: CSV, NMEA or GPX; default: positions.csv beside each ledger.
    width_m
        Working width, metres.
    overlap_m
        By how much a pass is meant to overlap the one before, metres.
    delay_s
        From ground to camera, seconds; default: found from the yields.
    antenna_ahead_m
        How far the antenna is in front of the share, metres.
    cell_m
        Side of a cell, metres.
    track_shift_s
        Added to the track's times, where its clock differs from the cameras'.
    raw
        Use every point that has a place.
    smooth
        A smooth surface (kriging) instead of each cell by itself.
    out
        Picture to write: .png, .svg, .pdf, .jpg; or .rrd for Rerun. Default: map.png beside the first ledger.
    title
        Over the picture.
    json
        Print the map as JSON on stdout and draw only what --out names.
    """
    from tuberline.cli.progress import ledger_bar
    from tuberline.cli.run_files import each_once, output
    from tuberline.maps.field import field_map
    from tuberline.maps.picture import PICTURES
    from tuberline.maps.settings import settings_of

    if out is not None and out.suffix.lower() not in (*PICTURES, ".rrd"):
        raise InputError(f"--out {out}: a map is written as {', '.join(PICTURES)}, or .rrd for Rerun: end its name so")
    runs, tracks = each_once(runs, track or [])
    target = output(runs, "map.png", out, read=tracks) if out is not None or not json else None
    settings = settings_of(
        runs,
        width_m=width_m,
        overlap_m=overlap_m,
        delay_s=delay_s,
        antenna_ahead_m=antenna_ahead_m,
        cell_m=cell_m,
        track_shift_s=track_shift_s,
        clean=not raw,
        smooth=smooth,
    )
    with ledger_bar("map"):
        field = field_map(runs, tracks, settings)
    if target is not None:
        if target.suffix.lower() == ".rrd":
            from tuberline.maps.in_rerun import write_rrd

            write_rrd(field, target)
        else:
            from tuberline.maps.picture import draw_map

            draw_map(field, target, title=title or "Yield")
        if not json:
            from tuberline.maps.told import print_map

            print_map(field, out=target)
    if json:
        sys.stdout.write(json_module.dumps(field.as_dict()) + "\n")
