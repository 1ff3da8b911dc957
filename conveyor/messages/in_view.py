"""What a camera has in view and is not counted yet: for people who look, and for nothing else."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from conveyor.messages.base import Message
from conveyor.ranges import BeltPlace, Id, InView, Items, Millimetres, Name, Nanoseconds, ViewGrams


@dataclass(frozen=True, slots=True)
class TrackInView:
    """A track as it is known now: its place, about how large it is, and what it weighs where a view was weighed.

    Attributes:
        side_mm: of a square as large as its visible outline.
        state: 'open', 'counted' by its camera (it reaches the ledger in a moment), or 'refused': no tuber.
        weight_g, low_g, high_g: by the views weighed so far, with their 90 % interval; None before the first.
    """

    track_id: Id
    place_x_m: BeltPlace
    place_y_m: InView
    side_mm: Millimetres
    height_mm: Millimetres
    state: Literal["open", "counted", "refused"]
    weight_g: ViewGrams | None = None
    low_g: ViewGrams | None = None
    high_g: ViewGrams | None = None


@dataclass(frozen=True, slots=True)
class TracksInView(Message):
    """All tracks that `camera` has in view at `captured_ns`. Provisional: what counts is in its log."""

    LATER_FIELDS = "ignore"

    camera: Name
    run: Name
    captured_ns: Nanoseconds
    tracks: Annotated[tuple[TrackInView, ...], Items(1024)]
