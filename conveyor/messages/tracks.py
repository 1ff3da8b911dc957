"""A camera's log: what the segmenter tells the aggregator, entry by entry, none skipped and none twice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from conveyor.messages.base import Message


@dataclass(frozen=True, slots=True)
class WeighedView:
    """One view's answer inside a finished track."""

    view_id: str
    seq: int
    weight_g: float
    low_g: float
    high_g: float
    method: Literal["pointraft", "volume"]
    model: str
    flags: tuple[str, ...]


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
    """

    track_id: str
    crossed_ns: int
    crossed_x_m: float
    y_m: float
    travel_m: float
    travel_estimated: bool
    frames: int
    first_seq: int
    last_seq: int
    length_mm: float
    width_mm: float
    height_mm: float
    visible_volume_ml: float
    whole: bool
    views_sent: int
    views: tuple[WeighedView, ...]
    views_lost: dict[str, int]

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
            received = processed + drops, published = received + gaps.
        views: sent, weighed, and 'lost_<reason>': sent = weighed + lost + outstanding.
        tracks: opened, counted, open, and 'discarded_<reason>': opened = counted + discarded + open.
    """

    captured_ns: int
    travel_m: float
    travel_estimated: bool
    complete_ns: int
    complete_place_x_m: float
    final: bool
    looked_at_m: float
    travelled_m: float
    frames: dict[str, int]
    views: dict[str, int]
    tracks: dict[str, int]


@dataclass(frozen=True, slots=True)
class TrackEntry(Message):
    """Entry `n` (1, 2, 3, ...) of the log of `camera` in `run`: a track or a mark, never both.

    The aggregator applies entry n only after n-1 and says `Committed` when it is durable; until then the segmenter
    keeps it and sends it again. Applying an entry twice changes nothing.
    """

    camera: str
    run: str
    n: int
    track: Track | None = None
    mark: Mark | None = None


@dataclass(frozen=True, slots=True)
class Committed(Message):
    """Entries 1..n of the log of `camera` in `run` are durable in the ledger."""

    camera: str
    run: str
    n: int
