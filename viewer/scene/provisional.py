"""Boxes of what is in view and not counted yet: grey from the first frames, with grams once a view is weighed.

A counted tuber takes over the box of its track, and is drawn at every moment at which that was: Rerun keeps all times,
and the past shall not show two boxes or an older weight. What is refused, or never counted, goes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from conveyor.messages import TrackInView, TracksInView
from viewer.scene.primitives import Box, Color, Entry, Gone, Moment
from viewer.scene.shapes import weight_color

UNKNOWN_COLOR: Color = (150, 150, 155)
MOVED_M = 0.008
"""A box is drawn again where its track's place is now known to be so far away: a tuber comes in cut by the border."""
TWIN_M = 0.025
"""Tracks of two cameras so near to each other are one tuber, as a rule: one box."""
UNCOUNTED_NS = 3_000_000_000
"""A track that was last heard of so long ago is not counted any more."""
REMEMBERED = 1024


@dataclass(slots=True)
class _Drawn:
    path: str
    camera: str
    place_m: tuple[float, float]
    weight_g: float | None
    heard_ns: int
    moments: list[Moment] = field(default_factory=list)


class Provisional:
    """By track, until it is counted or goes. `new_path` gives a box its place among the tubers."""

    def __init__(self, new_path: Callable[[], str]) -> None:
        self._new_path = new_path
        self._drawn: dict[str, _Drawn] = {}
        self._counted: dict[str, None] = {}

    def seen(self, message: TracksInView) -> list[Entry]:
        """What a camera has in view now: boxes that are new, weighed, moved or over."""
        moment = Moment(message.captured_ns)
        entries: list[Entry] = []
        for track in message.tracks:
            if track.track_id in self._counted:
                continue
            if track.state == "refused":
                entries += self._over(track.track_id, moment)
            elif self._is_news(track, message):
                entries.append(self._box(track, message.camera, moment))
        late = [i for i, drawn in self._drawn.items() if message.captured_ns - drawn.heard_ns > UNCOUNTED_NS]
        for track_id in late:
            entries += self._over(track_id, moment)
        return entries

    def counted(self, tracks: Iterable[str]) -> tuple[str | None, list[Moment], list[Entry]]:
        """(path, moments, entries): the box that a tuber of these tracks takes over, when it was drawn, and what of its
        other boxes has to go; no path where it had none."""
        mine: list[_Drawn] = []
        for track_id in tracks:
            self._counted[track_id] = None
            if (drawn := self._drawn.pop(track_id, None)) is not None:
                mine.append(drawn)
        while len(self._counted) > REMEMBERED:
            del self._counted[next(iter(self._counted))]
        if not mine:
            return None, [], []
        gone = [Entry(other.path, Gone(), moment) for other in mine[1:] for moment in other.moments]
        return mine[0].path, mine[0].moments, gone

    def _is_news(self, track: TrackInView, message: TracksInView) -> bool:
        place_m = (track.place_x_m, track.place_y_m)
        drawn = self._drawn.get(track.track_id)
        if drawn is not None:
            drawn.heard_ns = message.captured_ns
            weighed = track.weight_g is not None and track.weight_g != drawn.weight_g
            return weighed or math.dist(place_m, drawn.place_m) > MOVED_M
        others = (other for other in self._drawn.values() if other.camera != message.camera)
        return all(math.dist(place_m, other.place_m) > TWIN_M for other in others)

    def _box(self, track: TrackInView, camera: str, moment: Moment) -> Entry:
        place_m = (track.place_x_m, track.place_y_m)
        drawn = self._drawn.get(track.track_id)
        if drawn is None:
            drawn = _Drawn(self._new_path(), camera, place_m, None, moment.captured_ns)
            self._drawn[track.track_id] = drawn
        drawn.place_m = place_m
        drawn.weight_g = track.weight_g if track.weight_g is not None else drawn.weight_g
        drawn.moments.append(moment)
        return Entry(drawn.path, _provisional_box(track, drawn.weight_g), moment)

    def _over(self, track_id: str, moment: Moment) -> list[Entry]:
        drawn = self._drawn.pop(track_id, None)
        return [] if drawn is None else [Entry(drawn.path, Gone(), moment)]


def _provisional_box(track: TrackInView, weight_g: float | None) -> Box:
    half_m, high_m = track.side_mm / 2000, track.height_mm / 1000
    return Box(
        (track.place_x_m, track.place_y_m, high_m / 2),
        (half_m, half_m, high_m / 2),
        UNKNOWN_COLOR if weight_g is None else weight_color(weight_g),
        label="" if weight_g is None else f"≈ {weight_g:.0f} g",
    )
