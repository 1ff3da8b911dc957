"""A camera's log: what the segmenter tells the aggregator, entry by entry, none skipped and none twice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from conveyor.messages.base import Message
from conveyor.messages.sizes import Sizes
from conveyor.ranges import (
    INT64_MAX,
    MAX_COUNT,
    BeltLength,
    BeltPlace,
    Count,
    Counts,
    Id,
    InView,
    Items,
    Millilitres,
    Millimetres,
    Model,
    Name,
    Nanoseconds,
    Range,
    Seq,
    Sheet,
    ViewGrams,
    Words,
    Yes,
)

UNFOLLOWED = "unfollowed_ms"
"""In a mark's sheet of frames: how long load passed without an encoder of which it is not known how far it moved."""

CARRIED = "carried_ms"
"""In a mark's sheet of frames: for how long, without an encoder, no load was seen to move, so that travel was carried
on by the belt's last speed, or was told later, when a speed was known."""

Kind = Literal["tuber", "lump", "haulm"]
EntryNumber = Annotated[int, Range(1, MAX_COUNT, "entries")]


@dataclass(frozen=True, slots=True)
class WeighedView:
    """One view's answer inside a finished track; `sizes` None: by a regressor that says none."""

    view_id: Id
    seq: Seq
    weight_g: ViewGrams
    low_g: ViewGrams
    high_g: ViewGrams
    method: Literal["pointraft", "volume"]
    model: Model
    flags: Words
    sizes: Sizes | None = None


@dataclass(frozen=True, slots=True)
class Track:
    """The finished views of one tuber in one camera, whose centre crossed the image's centre row.

    Attributes:
        track_id: unique and the same in every replay: `<run>/<camera>/<first_seq>-<n>`.
        crossed_ns: camera time at which the centre crossed the centre row (interpolated between frames).
        crossed_x_m, y_m: belt coordinates of the tuber's centre at that moment, metres.
        travel_m: belt travel at that moment as this camera knows it; `travel_estimated`: not from an encoder.
        frames: frames in which it was seen; first_seq, last_seq: the first and last of them.
        length_mm, width_mm, height_mm: sorted horizontal axes of the visible outline and height above the belt.
        visible_volume_ml: volume under the visible surface down to the belt, median over whole views.
        whole: at least one view was not cut by the image border.
        views: the answers; views_sent = len(views) + sum(views_lost.values()).
        views_lost: views sent to a regressor without an answer to use, by reason.
        support_mm: height of the tubers that it lies on; 0 on the belt. Its height and volume are from there up.
        flags: what was wrong with the camera meanwhile (`conveyor.camera_flags`).
        kind: 'tuber'; or 'lump' (a clod or a stone) or 'haulm', which the segmenter refused and no one weighs.
        log_odds: of tuber against other, as the segmenter's classifier believes; None: it was not asked.
    """

    track_id: Id
    crossed_ns: Nanoseconds
    crossed_x_m: InView
    y_m: InView
    travel_m: BeltPlace
    travel_estimated: Yes
    frames: Count
    first_seq: Seq
    last_seq: Seq
    length_mm: Millimetres
    width_mm: Millimetres
    height_mm: Millimetres
    visible_volume_ml: Millilitres
    whole: Yes
    views_sent: Count
    views: Annotated[tuple[WeighedView, ...], Items(256)]
    views_lost: Counts
    support_mm: Millimetres = 0.0
    flags: Words = ()
    kind: Kind = "tuber"
    log_odds: Annotated[float, Range(-1000, 1000, "")] | None = None

    @property
    def place_x_m(self) -> float:
        """Place along the belt by this camera's own travel, metres."""
        return self.crossed_x_m - self.travel_m


@dataclass(frozen=True, slots=True)
class Mark:
    """How far the camera's log is complete, and its balance sheet so far.

    Attributes:
        captured_ns, travel_m: of the newest frame processed.
        complete_ns: every tuber that crossed the centre row at or before this camera time is in the log.
        complete_place_x_m: the same said in belt terms: every tuber at this place or further along is in the log.
        final: the camera ended; nothing follows.
        looked_at_m, travelled_m: belt length that passed the centre row, and how much of it was really looked at.
        frames: published (as far as known), received, processed, gaps, and drops by reason ('dropped_<reason>'):
            received = processed + drops, published = received + gaps. Also `UNFOLLOWED` and `CARRIED`,
            where there is such.
        views: sent, weighed, and 'lost_<reason>': sent = weighed + lost + outstanding. Of tracks that are not
            logged yet all are outstanding, answered or not.
        tracks: opened, counted, open, and 'discarded_<reason>': opened = counted + discarded + open; 'foreign' of the
            discarded are in the log as what they are.
    """

    captured_ns: Nanoseconds
    travel_m: BeltPlace
    travel_estimated: Yes
    complete_ns: Annotated[int, Range(-INT64_MAX, INT64_MAX, "ns")]
    complete_place_x_m: BeltPlace
    final: Yes
    looked_at_m: BeltLength
    travelled_m: BeltLength
    frames: Sheet
    views: Sheet
    tracks: Sheet


@dataclass(frozen=True, slots=True)
class TrackEntry(Message):
    """Entry `n` (1, 2, 3, ...) of the log of `camera` in `run`: a track or a mark, never both.

    The aggregator applies entry n only after n-1 and says `Committed` when it is durable; until then the segmenter
    keeps it and sends it again. Applying an entry twice changes nothing.
    """

    camera: Name
    run: Name
    n: EntryNumber
    track: Track | None = None
    mark: Mark | None = None


@dataclass(frozen=True, slots=True)
class Committed(Message):
    """Entries 1..n of the log of `camera` in `run` are durable in the ledger."""

    camera: Name
    run: Name
    n: Count
