"""The segmenter's core: one frame after the other, same frames in, same tracks and views out, bit for bit."""

from __future__ import annotations

from collections import Counter, deque

import numpy as np
from numpy.typing import NDArray

from conveyor.messages import Frame, Track
from conveyor.reasons import FrameDrop, TrackRefusal
from segmenter.belt_segmenter import BeltSegmenter, Found, Settings, row_place_m
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.belt_keeper import BeltKeeper
from segmenter.frame.belt_off import BeltOff
from segmenter.frame.constants import STOOD_TOLD
from segmenter.frame.depth_watch import DepthWatch
from segmenter.frame.gate import FrameGate
from segmenter.frame.instances import Instances
from segmenter.frame.plane import BeltCheck
from segmenter.gauge.keeper import GaugeKeeper
from segmenter.known import Known
from segmenter.outline.flanks import FlankReading
from segmenter.outline.watch import OutlineReading
from segmenter.perception import Perception
from segmenter.results import ClosedTrack, StepResult
from segmenter.resume import Resume
from segmenter.track.counting import Crossing
from segmenter.track.track import TrackState
from segmenter.waiting import WaitingSegmenter

GAUGE_FOLLOW_M = 0.012
"""A belt is followed so far where a gauge says that the mount moved; beyond `DRIFT_M` the alarm is raised as well."""
TOLD_WITHIN = 30
"""Frames in which an encoder that is started again, or had no count yet, tells travel."""

__all__ = ["ClosedTrack", "Segmenter", "Settings", "StepResult"]


class Segmenter:
    """Depth frames of one camera to counted tracks with their views. Holds no session and reads no clock.

    Until a belt is known it waits; from then on a `BeltSegmenter` does the work.
    """

    def __init__(self, settings: Settings, *, resume: Resume | None = None, known: Known | None = None) -> None:
        """`resume`: where an earlier process of the run left off. `known`: what is known of the camera already."""
        self._gate = FrameGate()
        self.gauge = GaugeKeeper(settings.gauge)
        self._off = BeltOff()
        self._depth = DepthWatch()
        self._belts = BeltKeeper(
            settings.belt_follow_m,
            given_sd_m=settings.belt_sd_m,
            web=settings.resting,
            in_use=resume is not None,
        )
        self._perception = Perception(settings.perception, settings.split)
        self._by_travel = settings.scale_by_travel
        self._not_told = 0
        self._waiting = WaitingSegmenter(settings, self._perception, resume)
        self._running: BeltSegmenter | None = None
        self._recalled = known
        self._unit_m = 0.0
        self.unlike_known = ""
        """Why what was known of the camera is not used, in words; empty where it is, and where nothing was known."""

    def step(self, frame: Frame) -> StepResult:
        """Take the next frame.

        Raises:
            InputError: the belt seen contradicts the calibration in all of the first frames, or there is neither.
        """
        drop = self._gate.drop(frame)
        if drop is not None:
            return self._dropped(drop)
        seen = self.gauge.corrected(frame)
        if self.gauge.moved:
            self._belts.may_follow(GAUGE_FOLLOW_M)
        if self._running is not None:
            self._belts.camera = self._running.correction
        belt = self.gauge.belt_of(self._belts.belt_of(seen))
        if belt is None:
            return self._dropped(FrameDrop.NO_BELT)
        if self._running is None:
            self._running = self._waiting.with_belt(belt, seen)
            self._recall(self._running, frame, belt)
        self._off.step(self._belts.check)
        off = () if self.gauge.reading is not None else self._off.flags()
        self._running.flags = (*self.gauge.flags(), *off)
        result = self._running.step(seen, belt)
        self._gate.processed(frame, instances=result.instances)
        self._depth.step(frame)
        self._not_told = 0 if self.told else self._not_told + 1
        return result

    def finish(self) -> list[ClosedTrack]:
        """Decide all tracks still open: the camera has ended.

        Raises:
            InputError: all that was seen contradicts the calibration.
        """
        self._belts.finish()
        return self._running.finish() if self._running else []

    def tracks_in_view(self) -> list[TrackState]:
        """Tracks whose place is in view, decided or not, but those too young to be more than noise."""
        return self._running.tracks_in_view() if self._running else []

    def take_foreign(self) -> tuple[Track, ...]:
        """What `finish` refused as a clod, a stone or haulm."""
        return self._running.decider.take_foreign() if self._running else ()

    @property
    def travel_m(self) -> float:
        """How far the belt has moved since the run began, at the last processed frame."""
        return self._running.follower.travel_m if self._running else self._waiting.travel_m

    @property
    def estimated(self) -> bool:
        """The run has no encoder: travel is estimated from the load, from the camera's own zero."""
        return self._running.follower.estimated if self._running else False

    @property
    def told(self) -> bool:
        """An encoder told the travel of the newest frame."""
        return self._running.follower.told if self._running else False

    @property
    def encoder_behind_m(self) -> float:
        """How far the encoder is behind the load, where that is too much to believe it; else 0."""
        return self._running.follower.behind_m if self._running else 0.0

    @property
    def torn_m(self) -> float:
        """How far the load jumped back in all, as no belt does, where no encoder tells travel; metres."""
        return self._running.follower.torn_m if self._running else 0.0

    @property
    def merged_masks(self) -> int:
        """Frames in which a given mask's label lies in several places apart."""
        return self._running.masks.merged if self._running else 0

    @property
    def outlines(self) -> OutlineReading | None:
        """How far the camera's outlines are off; None before enough tubers were seen twice."""
        return self._running.outlines.reading if self._running else None

    @property
    def flanks(self) -> FlankReading | None:
        """How far the camera raises flanks near outlines; None before enough tubers were seen twice."""
        return self._running.outlines.flanks.reading if self._running else None

    def gauges(self) -> dict[str, float]:
        """Levels of what encoder, load and given masks say, as `conveyor.belt_findings` takes them."""
        return {
            **(self._travel_gauge(self._running) if self._by_travel and self._running else {}),
            **(self.outlines.gauges() if self.outlines else {}),
            **(self.flanks.gauges() if self.flanks else {}),
            "encoder_behind_m": self.encoder_behind_m,
            "load_torn_m": self.torn_m,
            "masks_merged": self.merged_masks,
            "without_depth": self._depth.without_depth,
            "picture_stood": self._gate.stood if self._gate.stood >= STOOD_TOLD else 0,
            "like_clods": self._perception.like_clods,
        }

    @property
    def known(self) -> Known | None:
        """What is known of the camera and its belt by now; None before a belt is, where that is what was told."""
        running, belt = self._running, self.belt
        if running is None or belt is None:
            return self._recalled
        return Known(
            intrinsics=belt.intrinsics,
            depth_scale_m=self._unit_m,
            belt_distance_m=belt.distance_m,
            outlines=running.outlines.said,
            flanks_mm=running.outlines.flanks.said_mm,
            belt=self._perception.belt,
        )

    def _recall(self, running: BeltSegmenter, frame: Frame, belt: BeltGeometry) -> None:
        self._unit_m, known = frame.depth_scale_m, self._recalled
        if known is None:
            return
        self.unlike_known = known.unlike(frame, belt)
        if self.unlike_known:
            return
        running.outlines.recall(known.outlines, known.flanks_mm)
        self._perception.recall(known.belt)

    def _travel_gauge(self, running: BeltSegmenter) -> dict[str, float]:
        missing = self._not_told >= TOLD_WITHIN
        return {"scaled_by_travel": running.correction.farther, "travel_not_told": float(missing)}

    @property
    def belt(self) -> BeltGeometry | None:
        """The belt in use; None before the first."""
        return self._belts.belt

    @property
    def belt_check(self) -> BeltCheck:
        """What the newest check of the belt said, against the belt as given."""
        return self._belts.check

    @property
    def belt_hidden(self) -> str:
        """What is seen in place of the belt, in words; empty while the belt is seen."""
        return self._belts.hidden

    @property
    def camera_changed(self) -> str:
        """What of the newest frame is not as in the run's first one, in words; empty where all is."""
        return self._gate.changed

    @property
    def noise_px(self) -> float | None:
        """Local noise of the camera's depth, pixels of disparity at a baseline of 18 mm; None before it is known."""
        return self._running.noise.noise_px if self._running else None

    @property
    def instances(self) -> Instances | None:
        """Of the last processed frame; None before the first."""
        return self._running.instances if self._running else None

    @property
    def found(self) -> Found:
        """Tracks of the last processed frame, each with the index of the instance that shows it."""
        return self._running.found if self._running else []

    @property
    def taken_for_distractors(self) -> NDArray[np.bool_]:
        """(n,) which of `instances` belong to tracks that were refused as distractors."""
        return self._running.taken_for_distractors if self._running else np.zeros(0, bool)

    @property
    def rejected(self) -> deque[Crossing]:
        """Crossings of the newest tracks that were refused as distractors."""
        return self._running.decider.rejected if self._running else deque()

    @property
    def unanswered(self) -> int:
        """Tracks of which the classifier said no number: they count as if there were none."""
        return self._perception.unanswered

    @property
    def discarded(self) -> Counter[TrackRefusal]:
        """Tracks that do not count, by reason."""
        return self._running.decider.discarded if self._running else Counter()

    @property
    def refused(self) -> Counter[str]:
        """What looked like load in a frame but is no instance, by reason."""
        return self._running.refused if self._running else Counter()

    @property
    def counted(self) -> int:
        """Tracks that count."""
        return self._running.decider.counted if self._running else 0

    @property
    def looked_at_m(self) -> float:
        """Belt that passed the centre row and was looked at, metres."""
        return self._running.coverage.looked_at_m if self._running else self._waiting.looked_at_m

    @property
    def travelled_m(self) -> float:
        """Belt that passed the centre row, metres."""
        return self._running.coverage.travelled_m if self._running else self._waiting.travelled_m

    @property
    def unfollowed_ms(self) -> int:
        """How long load passed of which it is not known how far it moved, milliseconds."""
        return self._running.follower.unfollowed_ms if self._running else self._waiting.unfollowed_ms

    @property
    def carried_ms(self) -> int:
        """How long no load was seen to move, where no encoder tells travel, milliseconds."""
        return self._running.follower.carried_ms if self._running else self._waiting.carried_ms

    def track_counts(self) -> dict[str, int]:
        """opened = counted + discarded by reason + open; 'foreign' of the discarded are kept."""
        opened = self._running.tracker.opened if self._running else 0
        discarded = {f"discarded_{reason}": n for reason, n in sorted(self.discarded.items())}
        still_open = opened - self.counted - self.discarded.total()
        foreign = self._running.decider.foreign_kept if self._running else 0
        kept = {"foreign": foreign} if foreign else {}
        return {"opened": opened, "counted": self.counted, "open": still_open, **discarded, **kept}

    def complete_travel_m(self) -> float:
        """All tubers that crossed the centre row at or before this travel have been closed."""
        return self._running.complete_travel_m() if self._running else self._waiting.complete_travel_m()

    def complete_ns(self, complete_travel_m: float) -> int:
        """Capture time up to which all crossings lie at or before `complete_travel_m`."""
        return self._running.complete_ns(complete_travel_m) if self._running else self._waiting.complete_ns()

    def row_place_m(self, travel_m: float) -> float:
        """Place on the belt that crosses the centre row at a travel; the furthest along where the row lies askew."""
        return -travel_m if self.belt is None else row_place_m(self.belt, travel_m)

    def _dropped(self, reason: FrameDrop) -> StepResult:
        return StepResult(self.travel_m, self.estimated, 0, (), reason)
