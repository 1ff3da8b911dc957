"""The segmenter of a camera whose belt is known: seven steps from a depth frame to tracks that count."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from conveyor.gauge import Gauge
from conveyor.geometry import TYPICAL_BELT_SD_M
from conveyor.messages import Frame
from conveyor.reasons import TrackRefusal
from conveyor.resting import RestingLevel
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.constants import DRIFT_M
from segmenter.frame.heights import HeightMap, height_map
from segmenter.frame.instances import Instances, SplitSettings, given
from segmenter.frame.mask_watch import MaskWatch
from segmenter.frame.noise_watch import NoiseWatch
from segmenter.frame.sides import with_own_centres
from segmenter.outline.correction import CameraCorrection, correction_of
from segmenter.outline.watch import OutlineWatch
from segmenter.perception import Perception, PerceptionSettings
from segmenter.results import ClosedTrack, StepResult
from segmenter.resume import Resume
from segmenter.track.constants import TALLEST_M
from segmenter.track.counting import CountSettings
from segmenter.track.coverage import Coverage
from segmenter.track.decide import EARLY_FRAMES, Moment, TrackDecider
from segmenter.track.follow import BeltFollower, BeltMotion
from segmenter.track.layers import KEPT as RIMS_KEPT
from segmenter.track.layers import rim_of
from segmenter.track.track import State, TrackState
from segmenter.track.tracker import Tracker, TrackSettings
from segmenter.track.views import cut_out, slot_offsets

MARK_MARGIN_M = 0.01
"""Metres by which a watermark stays behind what may still be decided: places move by millimetres until then. On
simulated belts (touching, crowded, two cameras; easy and field; 15 and 30 frames/s) by 2.1 mm at most."""

Found = list[tuple[TrackState, int]]
"""Tracks with the index of the instance that shows them."""


@dataclass(frozen=True, slots=True)
class Settings:
    """All settings of the core."""

    split: SplitSettings = field(default_factory=SplitSettings)
    track: TrackSettings = field(default_factory=TrackSettings)
    count: CountSettings = field(default_factory=CountSettings)
    perception: PerceptionSettings = field(default_factory=PerceptionSettings)
    views_per_tuber: int = 3
    belt_sd_m: float = TYPICAL_BELT_SD_M
    resting: RestingLevel = field(default_factory=RestingLevel)
    belt_follow_m: float = DRIFT_M
    early_views: bool = False
    """Tell views that are settled before their track is decided."""
    hold_for_doubtful: bool = True
    """The watermark waits for a track that is past its decision and does not count yet, though more frames may show it,
    until it left the view. Of 559 tracks that counted on simulated belts none did so that late, and what waited held up
    the ledger for a second and more: a live line does not wait for it. Should it count after all, it comes late."""
    mark_margin_m: float = MARK_MARGIN_M
    gauge: Gauge | None = None
    scale_by_travel: bool = False
    """The encoder is known to be right: what distances contradict it by is taken off them."""


class BeltSegmenter:
    """One camera over a belt that is known. Steps are pure in the frames: same frames, same tracks, bit for bit.

    Attributes:
        belt: the newest geometry; travel is followed with the first one.
        instances: of the last frame, with the tracks that they show in `found`.
        flags: what is wrong with the camera, for the tracks that are decided.
    """

    def __init__(self, settings: Settings, belt: BeltGeometry, perception: Perception, resume: Resume | None) -> None:
        low_m, high_m = belt.x_range()
        offsets_m = slot_offsets(
            settings.views_per_tuber, half_view_m=(high_m - low_m) / 2, decide_m=settings.track.decide_m
        )
        self.belt = belt
        self.tracker = Tracker(belt, settings.track, offsets_m)
        self.follower = BeltFollower(belt, resume=resume)
        beyond_m = belt.x_range(TALLEST_M)[1] - belt.row_crossing_x(0.0, TALLEST_M)
        self.coverage = Coverage(high_m - low_m, beyond_m)
        self.decider = TrackDecider(settings.count, perception, belt_sd_m=settings.belt_sd_m, resting=settings.resting)
        self.noise = NoiseWatch()
        self.masks = MaskWatch()
        self.outlines = OutlineWatch(low_m, high_m)
        self.flags: tuple[str, ...] = ()
        self.refused: Counter[str] = Counter()
        self.instances: Instances | None = None
        self.found: Found = []
        self._settings = settings
        self._perception = perception
        self._last: Frame | None = None
        if resume is not None:
            self._carry_on(resume)

    def step(self, frame: Frame, belt: BeltGeometry) -> StepResult:
        """Take the next frame, over the belt as it is known now."""
        self.belt = self.tracker.belt = belt
        self.noise.step(frame)

        # Heights over the belt
        heights = self._heights(frame)

        # Instances of what lies on it
        instances = self._instances(frame, heights)

        # Travel of the belt, and which instance belongs to which track
        motion = self.follower.step(frame, heights, instances, self.tracker)

        # Tracks, with what this frame shows of them
        found = self._track(frame, instances, motion)

        # Top views to classify and depth crops to weigh
        self._collect(frame, heights, instances, found)

        # How far the camera's outlines are off
        self.outlines.step(frame, instances, found, self.tracker, motion.travel_m)

        # Tracks that are due: counted, or refused with a reason
        closed = self._decide(frame)
        early = self.decider.early(self._moment(frame)) if self._settings.early_views else []

        self.instances, self.found, self._last = instances, found, frame
        return StepResult(
            motion.travel_m,
            self.follower.estimated,
            len(instances),
            tuple(closed),
            early=tuple(early),
            foreign=self.decider.take_foreign(),
        )

    def finish(self) -> list[ClosedTrack]:
        """Decide all tracks still open: the camera has ended."""
        if self._last is None:
            return []
        return self.decider.decide(self._moment(self._last), everything=True)

    def tracks_in_view(self) -> list[TrackState]:
        """Tracks whose place is in view, decided or not, but those too young to be more than noise."""
        low_m, high_m = self.belt.x_range()
        at_m = self.follower.travel_m
        return [
            track
            for track in self.tracker.tracks
            if track.frames >= EARLY_FRAMES and low_m <= track.place_x_m + at_m <= high_m
        ]

    @property
    def taken_for_distractors(self) -> NDArray[np.bool_]:
        """(n,) which of `instances` belong to tracks that were refused as distractors."""
        taken = np.zeros(0 if self.instances is None else len(self.instances), bool)
        for track, index in self.found:
            taken[index] = track.reason is TrackRefusal.DISTRACTOR
        return taken

    def complete_travel_m(self) -> float:
        """All tubers that crossed the centre row at or before this travel have been closed."""
        travel_m = self.follower.travel_m
        margin_m = self._settings.mark_margin_m
        horizon_m = travel_m - self._settings.track.decide_m - margin_m
        for track in self.tracker.tracks:
            if track.state is State.OPEN:
                past_m = self.tracker.past_row_m(track, travel_m)
                if self._settings.hold_for_doubtful or track.waits or past_m < self._settings.track.decide_m:
                    horizon_m = min(horizon_m, travel_m - past_m - margin_m)
        return horizon_m

    def complete_ns(self, complete_travel_m: float) -> int:
        """Capture time up to which all crossings lie at or before `complete_travel_m`."""
        history = self.follower.history
        if history.anchor is None:
            return 0
        return history.anchor[0] - 1 if complete_travel_m < history.start_m else history.ns_at(complete_travel_m)

    def _carry_on(self, resume: Resume) -> None:
        """What an earlier process of the run counted stays counted; what it saw and did not log was not looked at."""
        unlogged_m = resume.unlogged_m(row_place_m(self.belt, 0.0))
        complete_m = resume.travel_m - unlogged_m
        self.follower.history.anchor = (resume.complete_ns, complete_m)
        self.coverage.resume(
            looked_at_m=max(0.0, resume.looked_at_m - unlogged_m),
            travelled_m=resume.travelled_m - unlogged_m,
            travel_m=complete_m,
        )

    def _heights(self, frame: Frame) -> HeightMap:
        return height_map(
            frame.depth, depth_scale_m=frame.depth_scale_m, belt=self.belt, pixel_mm=self._settings.split.pixel_mm
        )

    def _instances(self, frame: Frame, heights: HeightMap) -> Instances:
        """The frame's own masks where it has them; centres of what the sides cut are completed."""
        if frame.mask is None:
            instances = self._perception.find(heights, self.belt)
        else:
            instances = given(frame.mask, heights, self.belt)
            self.masks.step(instances, cell_mm=heights.cell_mm)
        self.refused.update(instances.refused)
        return with_own_centres(instances, self.belt)

    def _track(self, frame: Frame, instances: Instances, motion: BeltMotion) -> Found:
        self.coverage.earlier(motion.earlier)
        self.coverage.step(motion.travel_m, torn_m=self.follower.torn_m)
        return self.tracker.update(
            frame.seq, instances, motion.pairs, motion.travel_m,
            moved=motion.moved, travel_before_m=motion.before_m,
        )  # fmt: skip

    def _collect(self, frame: Frame, heights: HeightMap, instances: Instances, found: Found) -> None:
        travel_m = self.follower.travel_m
        if frame.mask is None:
            self._perception.observe(heights, instances, found, self.belt, travel_m)
        for track, index in found:
            if track.state is not State.OPEN:
                continue
            offset_m = self.tracker.past_row_m(track, travel_m)
            if track.shelf.wants(offset_m, whole=not bool(instances.cut[index].any())):
                candidate = cut_out(frame, instances, index, self.belt, offset_m=offset_m)
                if candidate is not None:
                    track.shelf.offer(candidate)
                    if candidate.whole and len(track.rims) < RIMS_KEPT:
                        track.rims.append(rim_of(instances, index, heights))

    @property
    def correction(self) -> CameraCorrection:
        """What is taken off the views that are sent now."""
        by_travel = self._settings.scale_by_travel and self.follower.told
        return correction_of(
            self.outlines.reading, self.outlines.flanks.reading, focal_px=self.belt.intrinsics.fx, by_travel=by_travel
        )

    def _moment(self, frame: Frame) -> Moment:
        correction = self.correction
        flags = (*self.flags, *correction.flags)
        return Moment(frame, self.tracker, self.follower, self.noise.noise_px, flags, correction)

    def _decide(self, frame: Frame) -> list[ClosedTrack]:
        closed = self.decider.decide(self._moment(frame), everything=False)
        self.tracker.drop_gone(self.follower.travel_m)
        self.outlines.keep_only(self.tracker.tracks)
        return closed


def row_place_m(belt: BeltGeometry, travel_m: float) -> float:
    """Place on the belt that crosses the centre row at a travel; the furthest along where the row lies askew."""
    k = belt.intrinsics
    rows = [
        belt.row_crossing_x(belt.belt_xy(u, k.cy, height_m)[1], height_m)
        for u in (0, k.width - 1)
        for height_m in (0.0, 0.04)
    ]
    return max(rows) - travel_m
