"""Tubers and loads of runs as tables."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from aggregator.ledger.reader import all_runs, ledger_file, read_sums, reading, runs_in_words
from aggregator.ledger.stated import belt_of_run, stated_beside
from aggregator.ledger.totals_by import ALL, Labelled, Total, all_loads, total_of, totals_by
from conveyor import __version__
from conveyor.errors import InputError
from conveyor.messages import Tuber
from conveyor.typed_names import name_key
from tuberline.export.table import Column, Table, in_batches
from tuberline.maps.field import FieldPlaces

TUBER_COLUMNS = (
    Column("run", "text", "", "id of the run"),
    Column("tuber", "whole", "", "number of the tuber in its run, along the belt"),
    Column("time", "time", "", "when it crossed the camera's centre row"),
    Column("weight_g", "number", "g", "as weighed, not calibrated"),
    Column("low_g", "number", "g", "lower end of the weight's 90 % interval"),
    Column("high_g", "number", "g", "upper end of the weight's 90 % interval"),
    Column("length_mm", "number", "mm", "longest axis"),
    Column("width_mm", "number", "mm", "second axis"),
    Column("height_mm", "number", "mm", "height over where it rested"),
    Column("belt_x_m", "number", "m", "place on the belt, along"),
    Column("belt_y_m", "number", "m", "place on the belt, across"),
    Column("views", "whole", "", "views that weighed it"),
    Column("method", "text", "", "pointraft, or volume where no view could be weighed"),
    Column("model", "text", "", "weights that weighed it"),
    Column("flags", "text", "", "what is to be known of it, joined by ;"),
)
PLACE_COLUMNS = (
    Column("lat_deg", "number", "deg", "where it grew, WGS84"),
    Column("lon_deg", "number", "deg", "where it grew, WGS84"),
)
LOAD_COLUMNS = (
    Column("load", "text", "", "name of the load; all: their sum"),
    Column("tubers", "whole", "", "counted"),
    Column("as_weighed_kg", "number", "kg", "not calibrated, of what was seen: as_weighed_g of summary.json"),
    Column("weight_kg", "number", "kg", "calibrated, made up for belt that was not seen"),
    Column("low_kg", "number", "kg", "lower end of the weight's 90 % interval"),
    Column("high_kg", "number", "kg", "upper end of the weight's 90 % interval"),
    Column("coverage", "number", "share", "of the belt that was looked at"),
    Column("ticket_kg", "number", "kg", "what a scale said, net; of all: of the loads that have a ticket"),
    Column("raw_kg", "number", "kg", "not calibrated, made up for belt that was not seen"),
    Column("remarks", "text", "", "which of its runs were cut off or repaired with losses; empty where none was"),
)


def tubers_table(runs: Sequence[Path], field: FieldPlaces | None, tubers: Sequence[Iterable[Tuber]]) -> Table:
    """Every tuber of `runs`; with a place where `field` knows the machines' ways. Rows are read as they are written.

    `tubers`: those of each ledger.

    Raises:
        InputError: the runs hold no tuber.
    """
    if next((tuber for each in tubers for tuber in each), None) is None:
        raise InputError(f"{', '.join(map(str, runs))}: no tuber was counted, there is nothing to export")
    columns = TUBER_COLUMNS if field is None else TUBER_COLUMNS + PLACE_COLUMNS
    return Table("tubers", columns, _rows(tubers, field), about(runs))


def _rows(tubers: Sequence[Iterable[Tuber]], field: FieldPlaces | None) -> Iterator[tuple[Any, ...]]:
    for number, each in enumerate(tubers):
        if field is None:
            yield from map(_tuber, each)
            continue
        for batch in in_batches(each):
            for tuber, place in zip(batch, _places(field, number, batch), strict=True):
                yield (*_tuber(tuber), *place)


def loads_table(runs: Sequence[Path]) -> Table:
    """One row per load, with its interval; no weight where no belt was seen, which is not one of 0 kg."""
    return Table("loads", LOAD_COLUMNS, [_load(total) for total in totals_by(runs, "load")[0]], about(runs))


def _load(total: Total) -> tuple[Any, ...]:
    sums = total.sums
    grams = (sums.as_weighed_g, sums.estimated_g, sums.low_g, sums.high_g, total.raw_g)
    as_weighed, kg, low, high, raw = (g / 1000 if sums.saw else None for g in grams)
    ticket_kg = total.net_g / 1000 if total.weighed else None
    told = " ".join(total.remarks)
    return total.label, sums.tubers, as_weighed, kg, low, high, sums.coverage, ticket_kg, raw, told


def about(runs: Sequence[Path]) -> dict[str, Any]:
    """What holds for all rows: program, and of each ledger its runs with weights, calibration, coverage and totals.

    By the ledgers as they are now: a line that was stopped has no summary in its ledger, and tickets come later.
    """
    found, read = [], all_loads(runs)
    for path in runs:
        file = ledger_file(path)
        with reading(file) as db:
            known = all_runs(db, file)
            sums_of = {run.run: read_sums(db, run.run) for run in known}
            models = {model for sums in sums_of.values() for model in sums.load.models()}
            belt = belt_of_run(db, known[-1].run, sums_of[known[-1].run], stated_beside(file))
        loads = read.of(path)
        whole, by = total_of(ALL, loads), (load.one.totals.calibrated().told for load in loads)
        sums = whole.sums
        counted = sums.tubers > 0
        found.append(
            {
                "run": runs_in_words([run.run for run in known]),
                "line": known[-1].line,
                "grown": _grown(loads),
                "finished": all(run.finished for run in known),
                "remarks": list(whole.remarks),
                "weights": sorted(models),
                "calibrated_by": "; ".join(dict.fromkeys(filter(None, by))) or "nothing",
                "coverage": sums.coverage,
                "weight_g": sums.estimated_g if counted else None,
                "low_g": sums.low_g if counted else None,
                "high_g": sums.high_g if counted else None,
                "belt": dict(belt or {}),
            }
        )
    return {"made_by": f"tuberline {__version__}", "made_at": _time(datetime.now(UTC).timestamp()), "runs": found}


def _grown(loads: Sequence[Labelled]) -> list[dict[str, str]]:
    """Field and variety of what was counted, each pair once; '' where a load does not name it."""
    pairs: dict[tuple[str, str], tuple[str, str]] = {}
    for load in loads:
        if load.one.totals.sums.count:
            field, variety = load.load.field if load.load else "", load.one.variety
            pairs.setdefault((name_key(field), name_key(variety)), (field, variety))
    return [{"field": field, "variety": variety} for field, variety in pairs.values() if field or variety]


def _tuber(tuber: Tuber) -> tuple[Any, ...]:
    return (
        tuber.run,
        tuber.tuber_id,
        _time(tuber.crossed_ns / 1e9),
        tuber.weight_g,
        tuber.low_g,
        tuber.high_g,
        tuber.length_mm,
        tuber.width_mm,
        tuber.height_mm,
        tuber.place_x_m,
        tuber.place_y_m,
        tuber.views,
        tuber.method,
        tuber.model,
        ";".join(tuber.flags),
    )


def _places(field: FieldPlaces, number: int, tubers: Sequence[Tuber]) -> list[tuple[float | None, float | None]]:
    """Latitude and longitude of where each tuber grew; None where the machine's place was not known."""
    share = field.shares[number]
    crossed_s = np.array([tuber.crossed_ns for tuber in tubers]) / 1e9
    xy_m = share.way.at(crossed_s - share.delay.delay_s)
    known = np.isfinite(xy_m[:, 0])
    lat, lon = field.plane.to_degrees(np.nan_to_num(xy_m))
    return [(float(a), float(b)) if there else (None, None) for a, b, there in zip(lat, lon, known, strict=True)]


def _time(unix_s: float) -> str:
    return datetime.fromtimestamp(unix_s, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
