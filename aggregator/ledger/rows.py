"""Messages as rows of the ledger, and back. Lists are kept as JSON text."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

from aggregator.core.foreign import ForeignBody
from aggregator.core.machine import Applied, Observation
from aggregator.ledger.schema import SIZE_COLUMNS, row
from conveyor.messages import Mark, Sizes, Tuber


def entry_row(applied: Applied) -> tuple[Any, ...]:
    """Row of table `entry`."""
    entry = applied.logged.entry
    kind = "refused" if applied.logged.refused else "mark" if entry.mark is not None else "track"
    return row((entry.run, entry.camera, entry.n, kind, applied.late_from_x_m, applied.logged.payload))


def tuber_row(tuber: Tuber) -> tuple[Any, ...]:
    """Row of table `tuber`."""
    return row(
        (
            tuber.run,
            tuber.tuber_id,
            tuber.crossed_ns,
            float(tuber.place_x_m),
            float(tuber.place_y_m),
            float(tuber.weight_g),
            float(tuber.low_g),
            float(tuber.high_g),
            float(tuber.length_mm),
            float(tuber.width_mm),
            float(tuber.height_mm),
            tuber.views,
            tuber.method,
            tuber.model,
            json.dumps(tuber.flags),
            json.dumps(tuber.cameras),
            json.dumps(tuber.tracks),
            *sizes_columns(tuber.sizes),
            None if tuber.log_odds is None else float(tuber.log_odds),
        )
    )


def tuber_from(columns: Sequence[Any]) -> Tuber:
    """The tuber of a row (columns in the table's order, `crc` left out)."""
    run, tuber_id, crossed_ns, *numbers = columns[:11]
    views, method, model, flags, cameras, tracks = columns[11:17]
    x_m, y_m, weight_g, low_g, high_g, length_mm, width_mm, height_mm = numbers
    return Tuber(
        tuber_id=tuber_id,
        run=run,
        crossed_ns=crossed_ns,
        place_x_m=x_m,
        place_y_m=y_m,
        weight_g=weight_g,
        low_g=low_g,
        high_g=high_g,
        length_mm=length_mm,
        width_mm=width_mm,
        height_mm=height_mm,
        views=views,
        method=method,
        model=model,
        flags=tuple(json.loads(flags)),
        cameras=tuple(json.loads(cameras)),
        tracks=tuple(json.loads(tracks)),
        sizes=None if columns[17] is None else Sizes(*columns[17:25]),
        log_odds=columns[25],
    )


def sizes_columns(sizes: Sizes | None) -> tuple[float | None, ...]:
    """Sizes as columns of table `tuber`, in the order of `SIZE_COLUMNS`."""
    if sizes is None:
        return (None,) * len(SIZE_COLUMNS)
    return tuple(float(getattr(sizes, field.name)) for field in fields(sizes))


def body_row(body: ForeignBody) -> tuple[Any, ...]:
    """Row of table `foreign_body`."""
    numbers = (body.place_x_m, body.place_y_m), (body.length_mm, body.width_mm, body.height_mm, body.volume_ml)
    return row(
        (
            body.run,
            body.body_id,
            body.crossed_ns,
            *(float(value) for value in numbers[0]),
            body.kind,
            *(float(value) for value in numbers[1]),
            json.dumps(body.cameras),
            json.dumps(body.tracks),
            None if body.log_odds is None else float(body.log_odds),
        )
    )


def body_from(columns: Sequence[Any]) -> ForeignBody:
    """The body of a row (columns in the table's order, `crc` left out)."""
    run, body_id, crossed_ns, x_m, y_m, kind, length_mm, width_mm, height_mm, volume_ml = columns[:10]
    cameras, tracks, log_odds = columns[10:13]
    return ForeignBody(
        body_id=body_id,
        run=run,
        crossed_ns=crossed_ns,
        place_x_m=x_m,
        place_y_m=y_m,
        kind=kind,
        length_mm=length_mm,
        width_mm=width_mm,
        height_mm=height_mm,
        volume_ml=volume_ml,
        cameras=tuple(json.loads(cameras)),
        tracks=tuple(json.loads(tracks)),
        log_odds=log_odds,
    )


def observation_row(run: str, seen: Observation) -> tuple[Any, ...]:
    """Row of table `observation`."""
    return row(
        (
            run,
            seen.camera,
            seen.n,
            seen.track_id,
            seen.role.value,
            seen.tuber_id,
            float(seen.place_x_m),
            float(seen.place_y_m),
            seen.first_seq,
            seen.last_seq,
        )
    )


def coverage_row(run: str, camera: str, n: int, mark: Mark) -> tuple[Any, ...]:
    """Row of table `coverage`."""
    return row(
        (
            run,
            camera,
            n,
            mark.captured_ns,
            float(mark.travel_m),
            int(mark.travel_estimated),
            float(mark.complete_place_x_m),
            int(mark.final),
            float(mark.looked_at_m),
            float(mark.travelled_m),
        )
    )
