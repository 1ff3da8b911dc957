"""One tuber followed through the frames of one camera."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from conveyor.reasons import TrackRefusal
from segmenter.classify.evidence import Answer
from segmenter.classify.patch import Patch
from segmenter.track.constants import CUT_TRUST, KEPT_FRAMES, ODD_AREA, ODD_TRUST, TRUST_CAP
from segmenter.track.layers import evidence
from segmenter.track.views import ViewShelf


def trusted(trust: float, weight: float) -> float:
    """Effective number of readings behind a place, with one more of this weight."""
    return min(trust, TRUST_CAP) + weight


def middle(values: list[float]) -> float:
    """The median: as `statistics.median`, without its checks, for it is asked for with every reading."""
    values.sort()
    half = len(values) // 2
    return values[half] if len(values) % 2 else (values[half - 1] + values[half]) / 2


class State(StrEnum):
    """Where a track stands."""

    OPEN = "open"
    COUNTED = "counted"
    DISCARDED = "discarded"


@dataclass(frozen=True, slots=True)
class Hit:
    """The tuber in one frame, SI units, places in belt coordinates.

    `whole`: not cut by a border; `ends_cut`: by the first or last row; `part`: cut by a side, its place is that of the
    part seen; `contact`: share of the outline that touches another instance.
    """

    seq: int
    x_m: float
    y_m: float
    travel_m: float
    area_m2: float
    volume_m3: float
    height_m: float
    contact: float
    whole: bool
    ends_cut: bool
    part: bool = False


@dataclass(slots=True)
class TrackState:
    """What is known of a track so far. Places are x - travel and y, metres.

    `hits` are its readings, `KEPT_FRAMES` at most. `frames` counts frames in which the belt had moved since the one
    counted before; a standing belt adds none. `covered`: frames that did not show it but a much larger instance at its
    place.
    `sent_early`: wanted positions whose view was given to be weighed before the decision.
    `rims`: readings of its rim (`segmenter.track.layers.rim_of`).
    `waits`: it is due, and its turn comes in one of the next frames.
    `answer` is what the classifier said of its patch; None before, and without a classifier.
    """

    number: int
    first_seq: int
    countable: bool
    place_x_m: float
    place_y_m: float
    trust: float
    area_m2: float
    height_m: float
    shelf: ViewShelf
    last_seq: int = 0
    missed: int = 0
    vacant: int = 0
    covered: int = 0
    frames: int = 0
    state: State = State.OPEN
    reason: TrackRefusal | None = None
    hits: list[Hit] = field(default_factory=list)
    patch: Patch = field(default_factory=Patch)
    waits: bool = False
    answer: Answer | None = None
    sent_early: set[int] = field(default_factory=set)
    rims: list[NDArray[np.float64]] = field(default_factory=list)
    _said: tuple[int, float | None] = (0, None)

    def track_id(self, run: str, camera: str) -> str:
        """Unique, and the same in every replay."""
        return f"{run}/{camera}/{self.first_seq}-{self.number}"

    def is_odd(self, area_m2: float) -> bool:
        """A visible area that says: this is a merge, or a part."""
        return max(area_m2 / self.area_m2, self.area_m2 / area_m2) > ODD_AREA and self.frames >= 3

    def said_by_rims(self) -> float | None:
        """Log-odds of lying on others, from `rims`; None without any."""
        if self._said[0] != len(self.rims):
            self._said = len(self.rims), evidence(self.rims)
        return self._said[1]

    def add(self, hit: Hit, *, moved: bool) -> None:
        """Take one more reading; `moved`: the belt moved since the last frame that was counted."""
        weight = CUT_TRUST if hit.ends_cut else ODD_TRUST if hit.part or self.is_odd(hit.area_m2) else 1.0
        self.trust = trusted(self.trust, weight)
        gain = weight / self.trust
        self.place_x_m += gain * (hit.x_m - hit.travel_m - self.place_x_m)
        self.place_y_m += gain * (hit.y_m - self.place_y_m)
        self.last_seq = hit.seq
        self.missed = self.vacant = 0
        if moved or not self.hits:
            self.frames += 1
            self.hits.append(hit)
            if len(self.hits) > KEPT_FRAMES:  # the belt shakes where it stands: every other one of the older half goes
                del self.hits[1 : KEPT_FRAMES // 2 : 2]
            recent = self.hits[-15:]
            self.area_m2 = middle([h.area_m2 for h in recent if not h.ends_cut] or [hit.area_m2])
            self.height_m = middle([h.height_m for h in recent])
