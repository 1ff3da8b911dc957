"""Where the belt is at each frame, from the encoder or the load itself, and which instance belongs to which track."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from conveyor.messages import Frame
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.heights import HeightMap
from segmenter.frame.instances import Instances
from segmenter.resume import Resume
from segmenter.track.history import TravelHistory
from segmenter.track.tracker import Tracker
from segmenter.track.travel import EarlierMove, TravelEstimator


@dataclass(frozen=True, slots=True)
class BeltMotion:
    """The belt at one frame.

    Attributes:
        travel_m: how far it has moved since the run began; before_m: the same at the frame before, None at the first.
        moved: it moved since the last frame that counts of its own.
        pairs: (index of track, index of instance) that belong together.
        earlier: how the belt moved before its speed was known, told once.
    """

    travel_m: float
    before_m: float | None
    moved: bool
    pairs: list[tuple[int, int]]
    earlier: Sequence[EarlierMove] = ()


class BeltFollower:
    """Travel of one camera's belt. `estimated`: the load tells it, there is no encoder."""

    def __init__(self, belt: BeltGeometry, *, resume: Resume | None = None) -> None:
        self.travel_m = resume.travel_m if resume else 0.0
        self.estimated = False
        self.history = TravelHistory()
        self._estimator = TravelEstimator(belt)
        self._begun = False
        self._earlier: list[EarlierMove] = []
        if resume is not None:
            self._estimator.start_at(resume.travel_m, unfollowed_ms=resume.unfollowed_ms)

    @property
    def unfollowed_ms(self) -> int:
        """As the estimator has it; 0 with an encoder."""
        return self._estimator.unfollowed_ms

    def step(self, frame: Frame, heights: HeightMap, instances: Instances, tracker: Tracker) -> BeltMotion:
        """Travel at this frame, and the matches of tracks and instances."""
        before_m = self.travel_m if self._begun else None
        self._begun = True
        follow = self._estimate if frame.travel_m is None else self._measure
        pairs = follow(frame, heights, instances, tracker)
        moved = self.history.step(frame.captured_ns, self.travel_m)
        earlier, self._earlier = self._earlier, []
        return BeltMotion(self.travel_m, before_m, moved, pairs, earlier)

    def _measure(
        self, frame: Frame, _heights: HeightMap, instances: Instances, tracker: Tracker
    ) -> list[tuple[int, int]]:
        assert frame.travel_m is not None
        self.travel_m, self.estimated = frame.travel_m, False
        self._estimator.start_at(frame.travel_m)
        return tracker.match(instances, self.travel_m)

    def _estimate(
        self, frame: Frame, heights: HeightMap, instances: Instances, tracker: Tracker
    ) -> list[tuple[int, int]]:
        self.travel_m, self.estimated = self._estimator.step(heights, frame.captured_ns), True
        # The speed is known for the first time: the belt moved before there was load to see that by.
        self._earlier = self._estimator.look_back()
        if self._earlier:
            before_m = sum(move.all_m for move in self._earlier)
            tracker.shift(before_m)
            self.history.shift(before_m)
            self.travel_m = self._estimator.travel_m
        # The raster tells travel to about a millimetre; the tubers that are tracked tell the rest.
        pairs = tracker.match(instances, self.travel_m)
        residual_m = tracker.residual_m(pairs, instances, self.travel_m)
        self.travel_m = self._estimator.correct(residual_m or 0.0)
        return pairs
