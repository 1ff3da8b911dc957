"""How much of the belt was really looked at, over all cameras."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

START_TOLERANCE_M = 0.5
"""Cameras of one line start and end a little apart; less than this (or 2 %) behind the others is not belt missed."""


@dataclass(frozen=True, slots=True)
class Looked:
    """What one camera's newest mark says: belt that passed its centre row, and what of it was looked at, metres."""

    looked_at_m: float
    travelled_m: float


def camera_shares(looked: Mapping[str, Looked | None]) -> dict[str, float | None]:
    """Share of the belt that each camera looked at, of all that passed the line; None before the belt moved.

    A camera that stopped early is measured by the belt that the others saw go by.
    """
    farthest_m = max((own.travelled_m for own in looked.values() if own), default=0.0)
    shares: dict[str, float | None] = {}
    for camera, own in looked.items():
        if farthest_m <= 0:
            shares[camera] = None
        elif own is None:
            shares[camera] = 0.0
        else:
            behind = own.travelled_m < 0.98 * farthest_m - START_TOLERANCE_M
            whole_m = farthest_m if behind else own.travelled_m
            shares[camera] = min(1.0, own.looked_at_m / whole_m) if whole_m > 0 else 0.0
    return shares


def combined_coverage(shares: Mapping[str, float | None], *, seen_by: Mapping[frozenset[str], int]) -> float | None:
    """Share of the line's tubers that passed under an open eye; None before the belt moved.

    Tubers that only camera A ever sees were lost where A did not look; those that A and B see only where neither did.
    So what is expected is each group's count over the share of belt that its cameras looked at together. For a camera
    that never looked there is nothing to go by: it is taken to have had a lane of its own.

    Args:
        seen_by: tubers counted, by the set of cameras that saw them.
    """
    if not shares or any(share is None for share in shares.values()):
        return None
    known = {camera: share for camera, share in shares.items() if share is not None}
    blind = sum(share <= 0 for share in known.values())
    lanes = (len(known) - blind) / len(known)
    seen = sum(seen_by.values())
    if not seen:
        return sum(known.values()) / len(known)
    expected = 0.0
    for cameras, count in seen_by.items():
        missed = math.prod(1.0 - known.get(camera, 0.0) for camera in cameras)
        expected += count / max(1.0 - missed, 0.01)
    return lanes * min(1.0, seen / expected)
