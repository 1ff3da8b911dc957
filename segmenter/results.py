"""What the segmenter's core says of a frame, and of a track that is decided."""

from __future__ import annotations

from dataclasses import dataclass

from conveyor.messages import Track, View
from conveyor.reasons import FrameDrop, TrackRefusal
from segmenter.classify.evidence import Answer


@dataclass(frozen=True, slots=True)
class ClosedTrack:
    """A counted track, its views not yet weighed, and the views to weigh, best first.

    `answer`: what is believed of it; None without a classifier, and where too little was seen.
    """

    track: Track
    views: tuple[View, ...]
    answer: Answer | None = None


@dataclass(frozen=True, slots=True)
class RefusedTrack:
    """A track that does not count; `foreign` where it is kept as a clod, a stone or haulm of a tuber's size."""

    reason: TrackRefusal
    foreign: Track | None = None


Decision = ClosedTrack | RefusedTrack


@dataclass(frozen=True, slots=True)
class StepResult:
    """What one frame led to.

    `dropped`: why the frame could not be used; None where it was processed. `closed` are tracks that count, `foreign`
    those that were refused and are kept as clods, stones or haulm. `early`: views of tracks that are not decided yet,
    which may be weighed already.
    """

    travel_m: float
    estimated: bool
    instances: int
    closed: tuple[ClosedTrack, ...]
    dropped: FrameDrop | None = None
    early: tuple[View, ...] = ()
    foreign: tuple[Track, ...] = ()
