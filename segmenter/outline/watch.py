"""A camera's outlines over many tubers: what it takes off them, or lets them grow by."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import median

import numpy as np
from numpy.typing import NDArray

from conveyor.messages import Frame
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.instances import Instances
from segmenter.outline.body import Body, body_of
from segmenter.outline.compare import Comparison, compare
from segmenter.outline.flanks import FlankWatch
from segmenter.track.track import State, TrackState, middle
from segmenter.track.tracker import Tracker
from segmenter.track.views import cut_out

LOOKS = 8
"""At a tuber on its way through the view, evenly apart."""
FIRST = 0.4
"""Of the view, in which a tuber must be seen first: there is the rest of it for other looks."""
MOST_CONTACT = 0.8
"""Share of an outline that may touch others: the rest of it is its own."""
LEAST_APART_M, FAR_APART = 0.1, 0.35
"""Belt travel between two looks that are compared, and as a share of the view: nearer, the one sees little that the
other does not. 0.35 of the view of a D405 are 18 degrees."""
SOON, HASTE = 20, 600
"""No more haste is made once so many tubers have said how far outlines are off, or some have and so many pairs were
compared."""
FOLLOWED, LOOKED_AT, PAIRS = (20, 2), (4, 1), (4, 1)
"""Tubers that are followed on their way at a time, at first and later; looks taken in a frame, and pairs of them
compared, at a millisecond each."""
LEAST_DIRECTIONS = 3
"""In which a tuber's outline must be known in all its frames together."""
KEPT, LEAST, LEAST_LOST = 60, 4, 10
"""Tubers that say how far outlines are off: the newest so many, and no fewer; no fewer for what outlines lose, which is
little beside what they grow by."""
TRAVEL_SD = 0.007
"""How well travel and distances agree before the load has said, as a share: encoders are calibrated to 0.5 %, depth to
1 % and better."""
LEAST_GROWN_PX, SURE = 1.0, 3.0
"""Less growth is left on, and so is what is less than so many standard errors."""
MEAN_MM, MEAN_SD_MM = 0.9, 2.0
"""What cameras of the training lose of outlines, and how unlike that another may be."""
FREE_MM, LEAST_BEYOND_MM = 1.5, 0.3
"""Weights know cameras that lose so much; what is lost beyond is told from so much on."""
LEAST_FARTHER = 0.02
"""Less is not told: a camera whose depth is bent across its image seems to be off by up to 1 %."""


@dataclass(frozen=True, slots=True)
class OutlineReading:
    """How far a camera's outlines are off.

    Attributes:
        lost_px: what is missing of outlines, pixels; below 0 they have grown. sd_px: how well that is known.
        as_seen_px: the same, were travel and distances to agree. mm_per_px: of a pixel at the tubers.
        farther: by how much farther away the camera puts tubers than the belt's travel says, as a share of their
            distance: its depth unit or the encoder is off by so much. 0.01 is 1 %. farther_sd: how well that is known.
        slip, slip_sd: the same as the surfaces alone say it; `farther` is nearer to 0, for both are well known as a
            rule.
        tubers: how many say so.
    """

    lost_px: float
    sd_px: float
    as_seen_px: float
    mm_per_px: float
    farther: float
    farther_sd: float
    tubers: int
    slip: float = 0.0
    slip_sd: float = 0.0

    @property
    def grown_px(self) -> float:
        """By how much outlines are to be cut back; 0 where they have not grown for sure.

        A camera whose depth is bent across its image puts tubers farther away than travel says, too: what only the one
        or the other reading says is not believed.
        """
        lost_px = max(self.lost_px, self.as_seen_px)
        return round(-lost_px, 1) if lost_px <= -max(LEAST_GROWN_PX, SURE * self.sd_px) else 0.0

    @property
    def lost_beyond_mm(self) -> float:
        """What outlines lose beyond what weights know, as far as that is sure; 0 where it is little or few say so."""
        lost_mm, sd_mm = min(self.lost_px, self.as_seen_px) * self.mm_per_px, self.sd_px * self.mm_per_px
        trust = MEAN_SD_MM**2 / (MEAN_SD_MM**2 + sd_mm**2)
        beyond_mm = MEAN_MM + trust * (lost_mm - MEAN_MM) - FREE_MM
        sure = self.tubers >= LEAST_LOST and lost_mm - sd_mm > FREE_MM
        return round(beyond_mm, 1) if sure and beyond_mm >= LEAST_BEYOND_MM else 0.0

    def gauges(self) -> dict[str, float]:
        """Levels as `conveyor.belt_findings` takes them."""
        off = abs(self.farther) >= max(LEAST_FARTHER, SURE * self.farther_sd)
        return {
            "outline_lost_px": self.lost_px,
            "outline_grown_px": self.grown_px,
            "farther_than_travel": self.farther if off else 0.0,
        }


class OutlineWatch:
    """Looks at each tuber a few times on its way, compares the looks, and keeps what they say.

    It goes by frames and tubers alone, so a replay measures what it measured before.
    """

    def __init__(self, low_m: float, high_m: float) -> None:
        """`low_m`, `high_m`: belt x at which the camera's view begins and ends."""
        view_m = high_m - low_m
        self._first_until_m = low_m + FIRST * view_m
        self._every_m = view_m / LOOKS
        self._apart_m = max(LEAST_APART_M, FAR_APART * view_m)
        self._bodies: dict[int, list[Body]] = {}
        self._seen_at_m: dict[int, float] = {}
        self._waiting: deque[tuple[int, Body, Body]] = deque()
        self._said: dict[int, list[Comparison]] = {}
        self._compared = self._shifts = 0
        self.reading: OutlineReading | None = None
        self.flanks = FlankWatch()

    def step(
        self,
        frame: Frame,
        instances: Instances,
        found: Sequence[tuple[TrackState, int]],
        tracker: Tracker,
        travel_m: float,
    ) -> None:
        """Another frame, with the tracks in it and which instance shows each: look, and compare what is next."""
        if tracker.shifts != self._shifts:  # how far apart earlier looks were is not known any more
            self._shifts = tracker.shifts
            self._bodies.clear()
            self._seen_at_m.clear()
            self._waiting.clear()
        late = len(self._said) >= SOON or (self._compared >= HASTE and self.reading is not None)
        looks = 0
        for track, index in found:
            if looks == LOOKED_AT[late]:
                break
            whole = not instances.cut[index].any() and instances.contact[index] <= MOST_CONTACT
            if whole and self._due(track, travel_m, most=FOLLOWED[late]):
                self._look(frame, instances, track, index, tracker.belt, travel_m)
                looks += 1
        self._compare(PAIRS[late])

    @property
    def said(self) -> tuple[tuple[Comparison, ...], ...]:
        """What pairs of frames say of each tuber's outline, the newest tuber last."""
        return tuple(map(tuple, self._said.values()))

    def recall(self, said: Sequence[tuple[Comparison, ...]], flanks_mm: NDArray[np.float64]) -> None:
        """Begin with what an earlier watch said of the same camera; the tubers that pass next take its tubers' place.

        Args:
            flanks_mm: as `FlankWatch.said_mm`.
        """
        self._said = {number: list(one) for number, one in zip(range(-len(said), 0), said, strict=True)}
        self._read()
        self.flanks.recall(flanks_mm)

    def keep_only(self, tracks: Sequence[TrackState]) -> None:
        """Forget what was seen of others: they have left the view."""
        numbers = {track.number for track in tracks if track.state is not State.DISCARDED}
        for number in [n for n in self._seen_at_m if n not in numbers]:
            del self._seen_at_m[number]
            self._bodies.pop(number, None)

    def _due(self, track: TrackState, travel_m: float, *, most: int) -> bool:
        """A tuber that is followed has moved on, or one may be followed from here on; `most` are at a time."""
        if track.state is State.DISCARDED:
            return False
        last_m = self._seen_at_m.get(track.number)
        if last_m is not None:
            return travel_m - last_m >= self._every_m
        return len(self._seen_at_m) < most and track.place_x_m + travel_m <= self._first_until_m

    def _look(
        self, frame: Frame, instances: Instances, track: TrackState, index: int, belt: BeltGeometry, travel_m: float
    ) -> None:
        self._seen_at_m[track.number] = travel_m
        candidate = cut_out(frame, instances, index, belt, offset_m=0.0)
        body = body_of(frame, candidate, instances, index, travel_m=travel_m) if candidate is not None else None
        if body is None:
            return
        earlier = self._bodies.setdefault(track.number, [])
        for other in earlier:
            if abs(travel_m - other.travel_m) >= self._apart_m:
                self._waiting.extend([(track.number, body, other), (track.number, other, body)])
        earlier.append(body)

    def _compare(self, pairs: int) -> None:
        news = False
        for _ in range(pairs):
            if not self._waiting:
                break
            number, first, second = self._waiting.popleft()
            said = compare(first, second, farther=self.reading.farther if self.reading else 0.0)
            self._compared += 1
            if said is not None and said.risen_m is not None:
                self.flanks.add(number, said.risen_m)
            if said is not None and (said.lost_px or number in self._said):
                self._said.setdefault(number, []).append(replace(said, risen_m=None))
                news = True
        while len(self._said) > KEPT:
            del self._said[next(iter(self._said))]
        if news:
            self._read()

    def _read(self) -> None:
        tubers = [said for said in self._said.values() if sum(len(one.lost_px) for one in said) >= LEAST_DIRECTIONS]
        if len(tubers) >= LEAST:
            self.reading = _reading(tubers)


def _reading(tubers: list[list[Comparison]]) -> OutlineReading:
    """Travel that is off moves surfaces from look to look, as outlines that are off would: what they slip by, on all
    tubers together, is taken off first, and how well that is known is part of how well outlines are.
    """
    slips = [[one for one in said if one.slip_m is not None] for said in tubers]
    slip, slip_sd = _middle(
        [
            -sum((one.slip_m or 0.0) * one.apart_m for one in said) / sum(one.apart_m**2 for one in said)
            for said in slips
            if said
        ]
    )
    trust = TRAVEL_SD**2 / (TRAVEL_SD**2 + slip_sd**2)
    farther, farther_sd = trust * slip, float(np.sqrt(trust)) * slip_sd
    stretch_px = median(_stretch_px(one) for said in tubers for one in said if one.lost_px)
    lost_px, lost_sd_px = _middle([_lost_px(said, farther) for said in tubers])
    as_seen_px, _ = _middle([_lost_px(said, 0.0) for said in tubers])
    return OutlineReading(
        lost_px=lost_px,
        sd_px=float(np.hypot(lost_sd_px, farther_sd * stretch_px)),
        as_seen_px=as_seen_px,
        mm_per_px=1e3 / median(one.px_per_m for said in tubers for one in said),
        farther=farther,
        farther_sd=farther_sd,
        tubers=len(tubers),
        slip=slip,
        slip_sd=slip_sd,
    )


def _lost_px(said: list[Comparison], farther: float) -> float:
    """The median of a tuber's directions, were its distances so much too large."""
    values: list[float] = []
    for one in said:
        stretched_px = farther * _stretch_px(one)
        values += [lost_px + stretched_px for lost_px in one.lost_px]
    return middle(values)


def _stretch_px(one: Comparison) -> float:
    """Pixels by which an outline seems off for each whole that travel is off."""
    return abs(one.apart_m) * one.px_per_m


def _middle(values: list[float]) -> tuple[float, float]:
    """The median and its standard error, by the median deviation; of none (0, 1)."""
    if not values:
        return 0.0, 1.0
    centre = median(values)
    spread = 1.4826 * median(abs(value - centre) for value in values)
    return centre, float(1.2533 * spread / len(values) ** 0.5)
