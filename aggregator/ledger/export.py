"""The ledger as text: with every digit, or canonically, so that two runs of one recording give the same bytes."""

from __future__ import annotations

import json
from collections.abc import Iterator

from aggregator.ledger.reader import RunRow, read_marks, read_tubers
from aggregator.ledger.verified import LedgerView
from conveyor.messages import Tuber
from conveyor.messages.base import plain

CANONICAL_VERSION = 1


def canonical_lines(view: LedgerView, run: RunRow) -> Iterator[str]:
    """The run as JSON lines that depend on the recording, the config and the weights alone.

    Left out: run id, times of this machine, process names, log entry numbers. Rounded: metres to 1 mm, grams to 0.1 g,
    millimetres to 0.1 mm. Tubers come by id, their order along the belt.
    """
    marks = read_marks(view, run)
    yield _line({"format": "tuberline ledger", "version": CANONICAL_VERSION, "cameras": list(run.cameras)})
    for camera in run.cameras:
        mark = marks.get(camera)
        yield _line(
            {
                "camera": camera,
                "final": mark is not None and mark.final,
                "looked_at_m": None if mark is None else _round(mark.looked_at_m, 3),
                "travelled_m": None if mark is None else _round(mark.travelled_m, 3),
            }
        )
    for tuber in read_tubers(view, run.run):
        yield _line(canonical_tuber(tuber))


def canonical_tuber(tuber: Tuber) -> dict[str, object]:
    """A tuber rounded and without its run's id."""
    return {
        "tuber": tuber.tuber_id,
        "crossed_ms": round(tuber.crossed_ns / 1e6),
        "place_x_m": _round(tuber.place_x_m, 3),
        "place_y_m": _round(tuber.place_y_m, 3),
        "weight_g": _round(tuber.weight_g, 1),
        "low_g": _round(tuber.low_g, 1),
        "high_g": _round(tuber.high_g, 1),
        "length_mm": _round(tuber.length_mm, 1),
        "width_mm": _round(tuber.width_mm, 1),
        "height_mm": _round(tuber.height_mm, 1),
        "views": tuber.views,
        "method": tuber.method,
        "model": tuber.model,
        "flags": list(tuber.flags),
        "cameras": list(tuber.cameras),
        "tracks": [track.removeprefix(f"{tuber.run}/") for track in tuber.tracks],
        **_sizes(tuber),
    }


def _sizes(tuber: Tuber) -> dict[str, object]:
    """Its sizes, where there are any: ledgers before version 4 have none."""
    if tuber.sizes is None:
        return {}
    return {"sizes": {name: _round(value, 1) for name, value in plain(tuber.sizes).items()}}


def full_lines(view: LedgerView, run: RunRow) -> Iterator[str]:
    """The run's tubers as JSON lines with every digit, by id."""
    for tuber in read_tubers(view, run.run):
        yield _line(plain(tuber))


def _round(value: float, digits: int) -> float:
    """Rounded, with one zero instead of two."""
    return round(value, digits) + 0.0


def _line(values: object) -> str:
    return json.dumps(values, sort_keys=True, separators=(",", ":"))
