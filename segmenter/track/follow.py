"""Where the belt is at each frame, from the encoder or the load itself, and which instance belongs to which track."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from conveyor.messages import Frame
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.heights import HeightMap
from segmenter.frame.instances import Instances
from segmenter.resume import Resume
from segmenter.track.constants import BELIEVED_BACK_M, MAX_SPEED_MPS
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
    """Travel of one camera's belt: by the encoder, where it told it at the run's first frame, else by the load.

    Where an encoder falls silent the load tells it from there on; when it is back it is right, and what is in view is
    moved to where it says. A run that began without one goes on without: another zero would lay its tubers elsewhere.

    Attributes:
        travel_m: of the newest frame.
        told: by an encoder, in the newest frame.
        behind_m: how far the encoder is behind the load, where that is too much to believe it; else 0.
    """

    def __init__(self, belt: BeltGeometry, *, resume: Resume | None = None) -> None:
        self.travel_m = resume.travel_m if resume else 0.0
        self.told = False
        self.behind_m = 0.0
        self.history = TravelHistory()
        self._by_encoder = resume.by_encoder if resume else None
        self._estimator = TravelEstimator(belt)
        self._begun = False
        self._newest_ns = 0
        self._before_m: float | None = None
        self._earlier: list[EarlierMove] = []
        if resume is not None:
            self._estimator.start_at(resume.travel_m, unfollowed_ms=resume.unfollowed_ms)
            self._estimator.carried_ms = resume.carried_ms

    @property
    def estimated(self) -> bool:
        """The run has no encoder: travel counts from the camera's own zero."""
        return self._by_encoder is False

    @property
    def unfollowed_ms(self) -> int:
        """As the estimator has it; 0 with an encoder."""
        return self._estimator.unfollowed_ms

    @property
    def carried_ms(self) -> int:
        """As the estimator has it; 0 with an encoder."""
        return self._estimator.carried_ms if self.estimated else 0

    @property
    def torn_m(self) -> float:
        """As the estimator has it; 0 while an encoder tells the travel."""
        return self._estimator.torn_m

    def step(self, frame: Frame, heights: HeightMap, instances: Instances, tracker: Tracker) -> BeltMotion:
        """Travel at this frame, and the matches of tracks and instances."""
        self._before_m = self.travel_m if self._begun else None
        if self._by_encoder is None:
            self._by_encoder = frame.travel_m is not None
        told_m = frame.travel_m if self._by_encoder else None
        if told_m is None or self._lost(told_m, frame.captured_ns):
            pairs = self._estimate(frame, heights, instances, tracker)
            self.told = told_m is not None and self._back_at(told_m, tracker)
        else:
            self.travel_m, self.told = told_m, True
            pairs = tracker.match(instances, told_m)
        if self.told:
            self._estimator.told(self.travel_m, heights, frame.captured_ns)
        self._begun, self._newest_ns = True, frame.captured_ns
        moved = self.history.step(frame.captured_ns, self.travel_m)
        earlier, self._earlier = self._earlier, []
        return BeltMotion(self.travel_m, self._before_m, moved, pairs, earlier)

    def _lost(self, told_m: float, captured_ns: int) -> bool:
        """How the belt came from the last frame to where the encoder has it now, the load alone can tell."""
        if not self._begun:
            return False
        reach_m = MAX_SPEED_MPS * max(0, captured_ns - self._newest_ns) * 1e-9
        return not self.told or told_m < self.travel_m - BELIEVED_BACK_M - reach_m

    def _back_at(self, told_m: float, tracker: Tracker) -> bool:
        """All that is in view is where the encoder says; False: it cannot be believed."""
        off_m = told_m - self.travel_m
        self.behind_m = -off_m if off_m < -BELIEVED_BACK_M else 0.0
        if self.behind_m:
            return False
        tracker.shift(off_m)
        self.history.shift(off_m)
        self.travel_m = told_m
        self._before_m = None if self._before_m is None else self._before_m + off_m
        return True

    def _estimate(
        self, frame: Frame, heights: HeightMap, instances: Instances, tracker: Tracker
    ) -> list[tuple[int, int]]:
        self.travel_m = self._estimator.step(heights, frame.captured_ns)
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
        self.travel_m = self._estimator.correct(residual_m)
        return pairs
