"""Do two cameras still agree on where the tubers lie that both see? By the newest rows of a run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations

import numpy as np

from aggregator.core.reasons import Role
from aggregator.ledger.rows import tuber_from
from aggregator.ledger.schema import OBSERVATION, TUBER
from aggregator.ledger.verified import LedgerView
from conveyor.common_places import Places, common_offset
from conveyor.messages import CamerasApart, Tuber

NEWEST = 160
"""Tracks of each camera that are looked at. More make it more certain, and slower to show that a camera was moved."""
ALONG_M, ACROSS_M = 2.0, 2.0
"""How far cameras may disagree: what hangs beside another one may be taken to hang at its place, and of two clocks that
differ each second is 0.3 m and more along the belt."""
GATE_SHARE = 0.5
"""Of the gate within which two tracks are one tuber: places scatter, and beyond it the first ones are missed."""
SURE = 3.0
"""Standard errors."""


def cameras_apart(view: LedgerView, run: str, cameras: Sequence[str], *, gate_mm: float) -> tuple[CamerasApart, ...]:
    """Every two cameras that share tubers, by names.

    Args:
        gate_mm: within which two tracks are one tuber.
    """
    seen = {camera: _newest(view, run, camera) for camera in sorted(cameras)}
    places = {}
    for camera, rows in seen.items():
        tubers = _tubers(view, run, [tuber_id for tuber_id, _, _ in rows])
        kept = [row for row in rows if row[0] in tubers and tubers[row[0]].weight_g > 0]
        own = [tubers[tuber_id] for tuber_id, _, _ in kept]
        xy_m = np.array([row[1:] for row in kept]).reshape(-1, 2)
        tall, heavy = np.array([t.height_mm for t in own]), np.array([t.weight_g for t in own])
        places[camera] = [tuber.tuber_id for tuber in own], Places(xy_m, tall, heavy)
    found = []
    for (first, (first_ids, first_at)), (second, (second_ids, second_at)) in combinations(places.items(), 2):
        offset = common_offset(first_at, second_at, along_m=ALONG_M, across_m=ACROSS_M)
        if offset is None:
            continue
        far_m, error_m = math.hypot(offset.along_m, offset.across_m), math.hypot(offset.along_sd_m, offset.across_sd_m)
        found.append(
            CamerasApart(
                first,
                second,
                along_mm=1000 * offset.along_m,
                across_mm=1000 * offset.across_m,
                shared=len(offset.pairs),
                twice=sum(first_ids[i] != second_ids[j] for i, j in offset.pairs.tolist()),
                alarm=far_m > max(GATE_SHARE * gate_mm / 1000, SURE * error_m),
            )
        )
    return tuple(found)


def _tubers(view: LedgerView, run: str, ids: Sequence[int]) -> dict[int, Tuber]:
    """By id. Each is asked for: between those of a camera that sees few may lie the whole run."""
    where = f"WHERE run = ? AND tuber_id IN ({', '.join('?' * len(ids))})"
    return {tuber.tuber_id: tuber for tuber in map(tuber_from, view.rows(TUBER, where, (run, *ids)))}


def _newest(view: LedgerView, run: str, camera: str) -> list[tuple[int, float, float]]:
    """Tuber and place of a camera's newest tracks that count."""
    where = f"WHERE run = ? AND camera = ? AND role = ? ORDER BY n DESC LIMIT {NEWEST:d}"
    rows = view.rows(OBSERVATION, where, (run, camera, str(Role.COUNTED)))
    return [(int(tuber_id), float(x_m), float(y_m)) for _, _, _, _, _, tuber_id, x_m, y_m, _, _ in rows]
