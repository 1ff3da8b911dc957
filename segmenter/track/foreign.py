"""What a refused track is: haulm by its shape, else 'lump': a clod or a stone, which depth does not tell apart."""

from __future__ import annotations

from typing import Literal

from conveyor.config_yield import CLOD_FILLED
from conveyor.messages import Track
from conveyor.reasons import TrackRefusal

HAULM_SLENDER = 4.0
"""Length over width from which on what the classifier refuses is a stalk; clods and stones have at most 2."""


def foreign_kind(reason: TrackRefusal | None, *, length_m: float, width_m: float) -> Literal["lump", "haulm"] | None:
    """The kind of what was refused for `reason`; None for a tuber, and for a part of one."""
    if reason is TrackRefusal.THIN:
        return "haulm"
    if reason is not TrackRefusal.DISTRACTOR:
        return None
    return "haulm" if length_m >= HAULM_SLENDER * width_m else "lump"


def is_crumb(refused: Track, *, least_ml: float) -> bool:
    """A clod or stone smaller than a tuber of `least_ml`: it looks as large as one by the air under its flanks.

    A share of foreign matter is one of bodies of a tuber's size; crumbs would swell it.
    """
    return refused.kind == "lump" and CLOD_FILLED * refused.visible_volume_ml < least_ml
