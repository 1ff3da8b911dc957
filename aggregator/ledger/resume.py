"""The state of a run that is to be gone on with, at a cost that does not grow with the run: from its sums, the newest
entries of each log, and a bounded number of marks.
"""

from __future__ import annotations

import math

from aggregator.core.machine import PendingTrack, Restored
from aggregator.core.travel import UNKNOWN, TravelKnown
from aggregator.ledger.reader import (
    RunRow,
    decoded,
    is_observed,
    read_coverage,
    read_entries_after,
    read_last_batch,
    read_mark,
)
from aggregator.ledger.sums import RunSums
from aggregator.ledger.verified import LedgerView
from conveyor.messages import Mark
from conveyor.messages.tracks import CARRIED

MARKS = 20
"""Marks of a camera that may not have been used for the watermark yet: its travel waits for the reference camera's."""

SAMPLES = 5000
"""Samples of travel from a run's beginning, and from its end: 5000 s of each."""

CARRIED_OF = 512
"""Newest marks of a camera that are asked for how long travel was carried on: half a minute of a live one's."""


def restore(view: LedgerView, run: RunRow, sums: RunSums) -> Restored:
    """Logs, marks, tracks not yet in a tuber, and the place up to which tubers are committed."""
    batch = read_last_batch(view, run.run)
    restored = Restored(
        begun=True,
        tubers=sums.last_tuber_id,
        bodies=sums.last_body_id,
        watermark_x_m=batch[2] if batch else math.inf,
        travel=TravelKnown(sums.head_start_m, tuple(sums.turns)),
        sights=dict(sums.sights),
    )
    told = all(_told(view, run.run, camera) for camera in run.cameras)
    for camera in run.cameras:
        restored.marks[camera] = _marks(view, run.run, camera)
        restored.curves[camera] = [] if told else _curve(view, run.run, camera)
        settled = sums.settled.get(camera, 0)
        restored.applied[camera] = settled
        for found in read_entries_after(view, run.run, camera, settled):
            n, kind, late_from_x_m, payload = found[2:6]
            restored.applied[camera] = n
            if kind == "track" and not is_observed(view, run.run, camera, n):
                track = decoded(view, payload, f"run '{run.run}', camera '{camera}', n {n}").track
                if track is not None:
                    restored.pending.append(PendingTrack(camera, n, track, late_from_x_m))
    return restored


def _marks(view: LedgerView, run: str, camera: str) -> list[Mark]:
    numbers = [found[2] for found in read_coverage(view, run, camera, limit=MARKS, newest=True)]
    return [mark for n in numbers if (mark := read_mark(view, run, camera, n)) is not None]


def _told(view: LedgerView, run: str, camera: str) -> bool:
    """An encoder tells this camera where the belt is. One that has not marked yet may have none: then the marks of the
    others are needed to lay it beside them.
    """
    last = read_coverage(view, run, camera, limit=1, newest=True)
    return bool(last and not last[0][5])


def _curve(view: LedgerView, run: str, camera: str) -> list[tuple[int, float, int]]:
    """(capture time, travel, for how long it was carried on) of marks: the first and the newest. For how long is asked
    of the newest alone: what came of it before is in the turns.
    """
    newest = read_coverage(view, run, camera, limit=SAMPLES, newest=True)
    first = []
    if len(newest) == SAMPLES:
        first = [
            found for found in read_coverage(view, run, camera, limit=SAMPLES, newest=False) if found[2] < newest[0][2]
        ]
    asked = {found[2] for found in newest[-CARRIED_OF:]}
    return [
        (found[3], found[4], _carried_ms(view, run, camera, found[2]) if found[2] in asked else UNKNOWN)
        for found in (*first, *newest)
    ]


def _carried_ms(view: LedgerView, run: str, camera: str, n: int) -> int:
    mark = read_mark(view, run, camera, n)
    return mark.frames.get(CARRIED, 0) if mark else UNKNOWN
