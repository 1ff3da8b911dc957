"""From runs and tracks to one field's map."""

from __future__ import annotations

import math
from array import array
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aggregator.calibration.tickets import Ticket
from aggregator.core.loads import NO_LOAD
from aggregator.ledger.line_tickets import tickets_by_ledger
from aggregator.ledger.load_totals import ReadLoads
from aggregator.ledger.reader import (
    LedgerView,
    all_runs,
    ledger_file,
    read_tubers,
    reading,
    runs_in_words,
    the_run,
)
from aggregator.ledger.totals_by import ALL, labelled, total_of
from aggregator.yield_map.cells import YieldMap, cells_of, check_cell, factors_to_one_scale
from aggregator.yield_map.delay import Delay, delays
from aggregator.yield_map.no_map import NoMapError, WhyNoMap
from aggregator.yield_map.points import Crop, Machine, Points, cleaned, yield_points
from aggregator.yield_map.smooth import smoothed
from aggregator.yield_map.track import FieldPlane, Track, believed, plane_of
from aggregator.yield_map.track import Path as Way
from conveyor.errors import InputError
from conveyor.formats.positions import POSITIONS_FILE, read_positions
from conveyor.geometry import beside_deg
from conveyor.messages import Tuber
from conveyor.statistics import NORMAL_90

SUREST_SD_S = 3.0
"""A delay that is found less surely than this is not used."""
LEAST_SHARPNESS = 1.3
DAY_S = 86_400.0
"""Positions that lie farther from all tubers in time, and tubers from all positions, say nothing of each other."""
FAR_IN_TIME = "more than a day from any tuber"
MOST_DAYS = 400
"""Of one track: what spans more was stamped before its clock was set."""


@dataclass(frozen=True, slots=True)
class Settings:
    """How the map is made, and how a machine drives; metres and seconds. `delay_s` None: found from the yields. `clean`
    False keeps every point that has a place."""

    width_m: float
    overlap_m: float = 0.0
    delay_s: float | None = None
    antenna_ahead_m: float = 0.0
    cell_m: float = 10.0
    track_shift_s: float = 0.0
    clean: bool = True
    smooth: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class MachineShare:
    """What the runs of one ledger gave to the map.

    Attributes:
        run: its id, or those of the first and the last one of its ledger. width_m: of the machine.
        way: the machine's way, as far as it is believed.
        delay: by which the crop lags behind the ground; `by` 'given' where it was set.
        points: its yield points, each with the reason why it is not used.
        factor: by what the kilograms of its points were multiplied to meet the other runs.
        faults: positions not used, by reason.
        lost_kg: what passed the camera while the machine's place was not known.
        kg: all that its ledger holds, made up for belt that was not seen. tubers: how many those are.
    """

    run: str
    width_m: float
    delay: Delay
    way: Way
    points: Points
    factor: float
    faults: dict[str, int]
    lost_kg: float
    kg: float
    tubers: int


@dataclass(frozen=True, slots=True, eq=False)
class FieldPlaces:
    """Where each machine was, and what it lifted there: what a map is made of, and all that tubers' places need."""

    plane: FieldPlane
    shares: tuple[MachineShare, ...]


@dataclass(frozen=True, slots=True, eq=False)
class FieldMap(FieldPlaces):
    """The map and what it was made of."""

    cells: YieldMap

    def squares(self) -> NDArray[np.float64]:
        """(N, 5, 2) corners of the known cells, counter-clockwise and closed: longitude, in one piece, and latitude."""
        cells = self.cells
        square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * cells.cell_m / 2
        corners = cells.centres_m()[np.isfinite(cells.t_ha)][:, None] + square
        lat, lon = self.plane.to_degrees(corners.reshape(-1, 2))
        return np.stack([beside_deg(lon, self.plane.lon_deg), lat], axis=1).reshape(-1, 5, 2)

    def as_dict(self) -> dict[str, Any]:
        """What `tuberline map --json` prints: the cells, and how they came about."""
        cells = self.cells
        centres = cells.centres_m().reshape(-1, 2)
        lat, lon = self.plane.to_degrees(centres)
        known = np.flatnonzero(np.isfinite(cells.t_ha.ravel()))
        columns = (cells.t_ha, cells.low_t_ha, cells.high_t_ha, cells.kg, cells.area_m2, cells.count)
        names = ("t_ha", "low_t_ha", "high_t_ha", "kg", "area_m2", "tubers")
        return {
            "mean_t_ha": cells.mean_t_ha,
            "shared_percent": cells.shared_percent,
            "cell_m": cells.cell_m,
            "runs": [_told(share) for share in self.shares],
            "cells": [
                {
                    "lat_deg": float(lat[i]),
                    "lon_deg": float(lon[i]),
                    **{name: float(column.ravel()[i]) for name, column in zip(names, columns, strict=True)},
                }
                for i in known
            ],
        }


def field_map(
    runs: Sequence[Path],
    tracks: Sequence[Path],
    settings: Settings | Sequence[Settings],
    *,
    run: str | None = None,
    tubers: Sequence[Iterable[Tuber]] | None = None,
) -> FieldMap:
    """The map of one field.

    Args:
        runs: folders of runs, or ledgers; those of one ledger are of one machine.
        run: which one of a ledger that holds several; default: all of them.
        tracks: one file of positions per ledger, in their order; empty: the positions.csv beside each.
        settings: of all, or of the machine of each ledger; cells and smoothing are those of the first.
        tubers: those of each ledger, read in one pass; default: all that it holds.

    Raises:
        InputError: a run without positions or without tubers, or positions that cannot be used.
    """
    each = _of_each(runs, settings)
    places, shared = _places_of(runs, tracks, each, run, tubers)
    cell_m = each[0].cell_m
    cells = cells_of([share.points for share in places.shares], cell_m=cell_m, shared_percent=shared)
    if not np.isfinite(cells.t_ha).any():
        raise NoMapError(
            f"no cell of {cell_m:g} m has a quarter of its ground lifted by what can be used: give a smaller --cell-m",
            why=WhyNoMap.NO_GROUND,
        )
    return FieldMap(places.plane, places.shares, smoothed(cells) if each[0].smooth else cells)


def field_places(
    runs: Sequence[Path],
    tracks: Sequence[Path],
    settings: Settings | Sequence[Settings],
    *,
    tubers: Sequence[Iterable[Tuber]] | None = None,
) -> FieldPlaces:
    """Where the tubers of one field grew, also where too little was lifted for a map; arguments as of `field_map`.

    Raises:
        InputError: a run without positions or without tubers, or positions that cannot be used.
    """
    return _places_of(runs, tracks, _of_each(runs, settings), None, tubers)[0]


def check_tracks(runs: Sequence[Path], tracks: Sequence[Path]) -> None:
    """Refuse tracks of which it is not known to which run each belongs.

    Raises:
        InputError: there are some, and more or fewer than runs.
    """
    if tracks and len(tracks) != len(runs):
        raise InputError(f"{len(runs)} runs and {len(tracks)} tracks are given: give one --track for each run, or none")


def _of_each(runs: Sequence[Path], settings: Settings | Sequence[Settings]) -> Sequence[Settings]:
    if not runs:
        raise InputError("name at least one run: `tuberline map RUN`")
    return [settings] * len(runs) if isinstance(settings, Settings) else settings


def _places_of(
    runs: Sequence[Path],
    tracks: Sequence[Path],
    settings: Sequence[Settings],
    run: str | None,
    tubers: Sequence[Iterable[Tuber]] | None,
) -> tuple[FieldPlaces, float]:
    """(the places, half of the interval that all have in common, percent)."""
    for each in settings:
        Machine(each.width_m, 0.0, each.overlap_m, each.antenna_ahead_m)
        check_cell(each.cell_m)
    check_tracks(runs, tracks)
    known: Sequence[Iterable[Tuber] | None] = tubers or [None] * len(runs)
    found_tracks = tracks or _own_tracks(runs)
    calibrating = tickets_by_ledger(runs)
    read = [
        _read(file, track, how, run, own, tickets)
        for file, track, how, own, tickets in zip(runs, found_tracks, settings, known, calibrating, strict=True)
    ]
    plane = plane_of(read[0].track)
    found = [_points(machine, plane) for machine in read]
    widest_m = max(each.width_m for each in settings)
    factors = factors_to_one_scale([points for points, *_ in found], width_m=widest_m)
    shares = tuple(
        MachineShare(
            run=machine.run,
            width_m=machine.settings.width_m,
            delay=delay,
            way=way,
            points=points.scaled(factor),
            factor=factor,
            faults={**machine.left_out, **way.faults},
            lost_kg=lost_kg,
            kg=float(machine.crop.kg.sum()),
            tubers=len(machine.crop.kg),
        )
        for machine, (points, delay, way, lost_kg), factor in zip(read, found, factors, strict=True)
    )
    return FieldPlaces(plane, shares), max(machine.shared_percent for machine in read)


@dataclass(frozen=True, slots=True, eq=False)
class _Run:
    run: str
    settings: Settings
    crop: Crop
    track: Track
    left_out: dict[str, int]
    shared_percent: float


def _own_tracks(runs: Sequence[Path]) -> list[Path]:
    tracks = [ledger_file(run).parent / POSITIONS_FILE for run in runs]
    for run, track in zip(runs, tracks, strict=True):
        if not track.is_file():
            raise InputError(
                f"run {run} has no {POSITIONS_FILE}: give its positions with --track FILE (CSV, NMEA or GPX), or add "
                "[gnss] to the line's config and they are kept with the next run"
            )
    return tracks


def _read(
    run: Path,
    track: Path,
    settings: Settings,
    name: str | None,
    known: Iterable[Tuber] | None,
    tickets: Sequence[Ticket],
) -> _Run:
    file = ledger_file(run)
    with reading(file) as db:
        chosen = all_runs(db, file) if name is None else [the_run(db, file, name)]
        rows = (t for each in chosen for t in read_tubers(db, each.run)) if known is None else known
        crop, runs, shared_percent = _crop(db, run, rows, tickets)
    positions, left_out = _track(track, settings, crop)
    return _Run(
        run=runs_in_words(runs),
        settings=settings,
        crop=crop,
        track=positions,
        left_out=left_out,
        shared_percent=shared_percent,
    )


def _track(file: Path, settings: Settings, crop: Crop) -> tuple[Track, dict[str, int]]:
    """The positions of a file, those of the tubers' days where there are some; how many others it holds, by reason."""
    left_out: Counter[str] = Counter()
    places, shift_ns = read_positions(file, refused=left_out), round(settings.track_shift_s * 1e9)
    low_ns, high_ns = (crop.time_s.min() - DAY_S) * 1e9, (crop.time_s.max() + DAY_S) * 1e9
    near = [place for place in places if low_ns <= place.time_ns + shift_ns <= high_ns] or places
    track = Track(
        time_ns=np.array([place.time_ns + shift_ns for place in near], dtype=np.int64),
        lat_deg=np.array([place.lat_deg for place in near]),
        lon_deg=np.array([place.lon_deg for place in near]),
        quality=np.array([place.quality for place in near], dtype=np.uint8),
    )
    first_s, last_s = track.time_ns.min() / 1e9, track.time_ns.max() / 1e9
    if near is not places and last_s - first_s > MOST_DAYS * DAY_S:
        raise InputError(
            f"track {file} spans {_clock(first_s)} to {_clock(last_s)}, and so do tubers: a clock was set since: "
            f"give --track FILE with those of one time, {MOST_DAYS} days at most"
        )
    if len(near) < len(places):
        left_out[FAR_IN_TIME] += len(places) - len(near)
    return track, dict(left_out)


def _crop(
    db: LedgerView, run: Path, tubers: Iterable[Tuber], tickets: Sequence[Ticket]
) -> tuple[Crop, list[str], float]:
    """(the tubers with what each weighs, their runs in order, half of the interval of all in percent): calibrated, and
    made up for belt that was not seen. One pass, of which 40 bytes a tuber are kept.

    Each load has its own scale, by its tickets, its variety and the belt that was missed under it; a run without loads,
    too.
    """
    ledger = ReadLoads(db)
    crossed_ns, grams, at = array("q"), array("d"), array("q")
    stretches: dict[tuple[str, int], int] = {}  # what a run gave to a load
    for tuber in tubers:
        crossed_ns.append(tuber.crossed_ns)
        grams.extend((tuber.weight_g, tuber.low_g, tuber.high_g))
        at.append(stretches.setdefault((tuber.run, ledger.load_of(tuber)), len(stretches)))
    if not at:
        raise NoMapError(f"run {run} counted no tuber: there is nothing to map", why=WhyNoMap.NO_TUBERS)
    loads = labelled(ledger, tickets)
    scales = {(load.run, NO_LOAD): load.one.scale for load in loads if load.load is None}
    of_load = {load.load.number: load.one.scale for load in loads if load.load is not None}
    scale = np.array([scales[key] if key[1] == NO_LOAD else of_load[key[1]] for key in stretches])[np.array(at)]
    runs = list(dict.fromkeys(name for name, _ in stretches))
    sums = total_of(ALL, [load for load in loads if set(runs) & load.runs]).sums
    weight_g, low_g, high_g = np.array(grams).reshape(-1, 3).T
    crop = Crop(
        time_s=np.array(crossed_ns) / 1e9,
        kg=weight_g / 1000 * scale,
        sd_kg=(high_g - low_g) / (2 * NORMAL_90) / 1000 * scale,
    )
    return crop, runs, 50 * (sums.high_g - sums.low_g) / sums.estimated_g


def _points(machine: _Run, plane: FieldPlane) -> tuple[Points, Delay, Way, float]:
    path = believed(machine.track, plane)
    crop, settings = machine.crop, machine.settings
    if not ((crop.time_s >= path.time_s[0]) & (crop.time_s <= path.time_s[-1] + 600)).any():
        raise NoMapError(
            f"run {machine.run}: its tubers passed from {_clock(crop.time_s.min())} to {_clock(crop.time_s.max())}, "
            f"its positions are from {_clock(path.time_s[0])} to {_clock(path.time_s[-1])}: another day's track, or "
            "clocks that differ (--track-shift-s moves the track)",
            why=WhyNoMap.OTHER_TIMES,
        )
    if settings.delay_s is not None:
        delay = Delay(settings.delay_s, 0.0, "given", math.inf)
    else:
        near = (crop.time_s > path.time_s[0] - DAY_S) & (crop.time_s < path.time_s[-1] + DAY_S)
        delay = _found_delay(machine.run, delays(path, crop.only(near), width_m=settings.width_m))
    how = Machine(settings.width_m, delay.delay_s, settings.overlap_m, settings.antenna_ahead_m)
    points, lost_kg = yield_points(path, crop, how)
    unplaced = ~points.used
    lost_kg += float(points.kg[unplaced].sum())
    return cleaned(points) if settings.clean else points, delay, path, lost_kg


def _found_delay(run: str, found: list[Delay]) -> Delay:
    sure = [delay for delay in found if delay.sd_s <= SUREST_SD_S and delay.sharpness >= LEAST_SHARPNESS]
    if not sure:
        told = "; ".join(f"{d.delay_s:.1f} s by {d.by}, give or take {d.sd_s:.1f} s" for d in found) or "nothing found"
        raise InputError(
            f"run {run}: the time from the ground to the camera cannot be told from its yields ({told}): it takes "
            "opposite passes beside each other, or some stops; give it with --delay-s (a stopwatch will do)"
        )
    return sure[0]


def _clock(time_s: float) -> str:
    return datetime.fromtimestamp(time_s, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


def _told(share: MachineShare) -> dict[str, Any]:
    return {
        "run": share.run,
        "kg": share.kg,
        "kg_without_place": share.lost_kg,
        "delay_s": share.delay.delay_s,
        "delay_sd_s": share.delay.sd_s,
        "delay_by": share.delay.by,
        "factor": share.factor,
        "points": len(share.points.time_s),
        "points_unused": share.points.reasons(),
        "positions_unused": share.faults,
    }
