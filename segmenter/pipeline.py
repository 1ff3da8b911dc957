"""The segmenter's core: one frame after the other, same frames in, same tracks and views out, bit for bit."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError
from conveyor.geometry import TYPICAL_BELT_SD_M
from conveyor.messages import Frame, Track, View
from segmenter.classify.patch import Patch
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.belt_keeper import BeltKeeper
from segmenter.frame.heights import HeightMap, height_map
from segmenter.frame.instances import Instances, SplitSettings, given
from segmenter.frame.plane import DRIFT_M, BeltCheck
from segmenter.frame.sides import completed_centres
from segmenter.perception import Perception, PerceptionSettings
from segmenter.resume import Resume
from segmenter.track.counting import CountSettings, Crossing, class_refusal, crossing, refusal, shape_refusal
from segmenter.track.coverage import Coverage
from segmenter.track.history import TravelHistory
from segmenter.track.track import State, TrackState
from segmenter.track.tracker import Tracker, TrackSettings
from segmenter.track.travel import TravelEstimator
from segmenter.track.views import Candidate, cut_out, size_m, slot_offsets

LEAST_SEEN = 0.1
FROZEN_M = 0.001
"""A shorter way need not change a single pixel."""
HORIZON_MARGIN_M = 0.02
REJECTED_KEPT = 1000
"""Crossings of the newest tracks that the network took for distractors; all of them are in `discarded`."""


@dataclass(frozen=True, slots=True)
class Settings:
    """All settings of the core."""

    split: SplitSettings = field(default_factory=SplitSettings)
    track: TrackSettings = field(default_factory=TrackSettings)
    count: CountSettings = field(default_factory=CountSettings)
    perception: PerceptionSettings = field(default_factory=PerceptionSettings)
    views_per_tuber: int = 3
    belt_sd_m: float = TYPICAL_BELT_SD_M
    belt_follow_m: float = DRIFT_M


@dataclass(frozen=True, slots=True)
class ClosedTrack:
    """A counted track, its views not yet weighed, and the views to weigh, best first."""

    track: Track
    views: tuple[View, ...]


@dataclass(frozen=True, slots=True)
class StepResult:
    """What one frame led to. `dropped`: the reason where the frame could not be used; empty where it was processed."""

    travel_m: float
    estimated: bool
    instances: int
    closed: tuple[ClosedTrack, ...]
    dropped: str = ""


class Segmenter:
    """Depth frames of one camera to counted tracks with their views. Holds no session and reads no clock."""

    def __init__(self, settings: Settings, *, resume: Resume | None = None) -> None:
        self.settings = settings
        self.history = TravelHistory()
        self.discarded: Counter[str] = Counter()
        self.refused: Counter[str] = Counter()
        self.counted = 0
        self.tracker: Tracker | None = None
        self.instances: Instances | None = None
        self.perception = Perception(settings.perception, settings.split)
        self._belts = BeltKeeper(settings.belt_follow_m)
        self._found: list[tuple[TrackState, int]] = []
        self.rejected: deque[Crossing] = deque(maxlen=REJECTED_KEPT)
        self._coverage: Coverage | None = None
        self._resume = resume
        self._first: Frame | None = None
        self._last: Frame | None = None
        self._estimator: TravelEstimator | None = None
        self._processed = 0
        self.travel_m = resume.travel_m if resume else 0.0
        self.estimated = False

    def step(self, frame: Frame) -> StepResult:
        """Take the next frame.

        Raises:
            InputError: the belt seen contradicts the calibration, there is neither, or the camera changed in the run.
        """
        dropped = self._unusable(frame)
        if dropped:
            return StepResult(self.travel_m, self.estimated, 0, (), dropped)
        belt = self._belts.belt_of(frame)
        if belt is None:
            return StepResult(self.travel_m, self.estimated, 0, (), "no_belt")
        if self._resume is not None and self.tracker is None and frame.travel_m is None:
            self._resume = self._resume.brought_to(frame.captured_ns)
        tracker, coverage, estimator = self._parts(belt)
        heights = height_map(
            frame.depth, depth_scale_m=frame.depth_scale_m, belt=belt, pixel_mm=self.settings.split.pixel_mm
        )
        instances = self.perception.find(heights, belt) if frame.mask is None else given(frame.mask, heights, belt)
        instances = replace(instances, centre_m=completed_centres(instances, belt))
        self.refused.update(instances.refused)
        before_m = self.travel_m if self._processed else None
        pairs = self._follow_belt(frame, heights, instances, tracker, estimator)
        moved = self.history.step(frame.captured_ns, self.travel_m)
        found = tracker.update(
            frame.seq, instances, pairs, self.history, self.travel_m, moved=moved, travel_before_m=before_m
        )
        if frame.mask is None:
            self.perception.observe(heights, instances, found, belt, self.travel_m)
        coverage.step(self.travel_m)
        self._keep_views(frame, instances, found, belt, tracker)
        self.instances, self._found, self._last = instances, found, frame
        self._processed += 1
        closed = self._close(tracker, frame, everything=False)
        tracker.drop_gone(self.travel_m)
        return StepResult(self.travel_m, self.estimated, len(instances), tuple(closed))

    def finish(self) -> list[ClosedTrack]:
        """Decide all tracks still open: the camera has ended."""
        if self.tracker is None or self._last is None:
            return []
        return self._close(self.tracker, self._last, everything=True)

    @property
    def belt(self) -> BeltGeometry | None:
        """The belt in use; None before the first."""
        return self._belts.belt

    @property
    def belt_check(self) -> BeltCheck:
        """What the newest check of the belt said, against the belt as given."""
        return self._belts.check

    @property
    def looked_at_m(self) -> float:
        """Belt that passed the centre row and was looked at, metres."""
        return self._coverage.looked_at_m if self._coverage else self._resume.looked_at_m if self._resume else 0.0

    @property
    def travelled_m(self) -> float:
        """Belt that passed the centre row, metres."""
        return self._coverage.travelled_m if self._coverage else self._resume.travelled_m if self._resume else 0.0

    @property
    def held_for_distractors(self) -> NDArray[np.bool_]:
        """(n,) which of `instances` belong to tracks that are discarded as distractors."""
        held = np.zeros(0 if self.instances is None else len(self.instances), bool)
        for track, index in self._found:
            held[index] = track.reason == "distractor"
        return held

    def track_counts(self) -> dict[str, int]:
        """opened = counted + discarded by reason + open."""
        opened = self.tracker.opened if self.tracker else 0
        discarded = {f"discarded_{reason}": n for reason, n in sorted(self.discarded.items())}
        return {
            "opened": opened,
            "counted": self.counted,
            "open": opened - self.counted - self.discarded.total(),
            **discarded,
        }

    def complete_travel_m(self) -> float:
        """All tubers that crossed the centre row at or before this travel have been closed."""
        if self.tracker is None:
            return -self._resume.complete_place_x_m if self._resume else float("-inf")
        horizon_m = self.travel_m - self.settings.track.decide_m - HORIZON_MARGIN_M
        for track in self.tracker.tracks:
            if track.state is State.OPEN:
                horizon_m = min(horizon_m, self.travel_m - self.tracker.past_row_m(track, self.travel_m) - 0.01)
        return horizon_m

    def complete_ns(self, complete_travel_m: float) -> int:
        """Capture time up to which all crossings lie at or before `complete_travel_m`."""
        if self.history.anchor is None:
            return self._resume.complete_ns if self._resume else 0
        if complete_travel_m < self.history.start_m:
            return self.history.anchor[0] - 1
        return self.history.ns_at(complete_travel_m)

    def row_place_m(self, travel_m: float) -> float:
        """Place on the belt that crosses the centre row at a travel; the furthest along where the row lies askew."""
        if self.belt is None:
            return -travel_m
        k = self.belt.intrinsics
        rows = [
            self.belt.row_crossing_x(self.belt.belt_xy(u, k.cy, height_m)[1], height_m)
            for u in (0, k.width - 1)
            for height_m in (0.0, 0.04)
        ]
        return max(rows) - travel_m

    def _unusable(self, frame: Frame) -> str:
        """Why a frame cannot be processed; empty where it can."""
        if self._first is None:
            self._first = frame
        first = self._first
        if frame.intrinsics != first.intrinsics or frame.depth_scale_m != first.depth_scale_m:
            raise InputError(
                f"camera '{frame.camera}' changed within run '{frame.run}' at frame {frame.seq}: intrinsics "
                f"{frame.intrinsics}, depth scale {frame.depth_scale_m}; it began with {first.intrinsics}, "
                f"{first.depth_scale_m}. Start a new run after changing a camera"
            )
        if frame.mask is None and np.count_nonzero(frame.depth[::4, ::4]) < LEAST_SEEN * frame.depth.size / 16:
            return "blind"
        return "frozen" if self._frozen(frame) else ""

    def _frozen(self, frame: Frame) -> bool:
        """The picture stands still though the belt moved on. An empty belt may look the same in every frame."""
        last = self._last
        if last is None or frame.travel_m is None or last.travel_m is None or not self.instances:
            return False
        return abs(frame.travel_m - last.travel_m) >= FROZEN_M and np.array_equal(frame.depth, last.depth)

    def _parts(self, belt: BeltGeometry) -> tuple[Tracker, Coverage, TravelEstimator]:
        """Tracker, coverage and estimator, made when the first belt is known; the tracker gets every better one."""
        if self.tracker is None or self._coverage is None or self._estimator is None:
            low_m, high_m = belt.x_range()
            offsets_m = slot_offsets(self.settings.views_per_tuber, half_view_m=(high_m - low_m) / 2)
            self.tracker = Tracker(belt, self.settings.track, offsets_m)
            self._coverage = Coverage(high_m - low_m)
            self._estimator = TravelEstimator(belt)
            if self._resume is not None:
                self._estimator.start_at(self._resume.travel_m)
                unlogged_m = self._resume.unlogged_m(self.row_place_m(0.0))
                complete_m = self._resume.travel_m - unlogged_m
                self.history.anchor = (self._resume.complete_ns, complete_m)
                self._coverage.resume(
                    looked_at_m=max(0.0, self._resume.looked_at_m - unlogged_m),
                    travelled_m=self._resume.travelled_m - unlogged_m,
                    travel_m=complete_m,
                )
        self.tracker.belt = belt
        return self.tracker, self._coverage, self._estimator

    def _follow_belt(
        self, frame: Frame, heights: HeightMap, instances: Instances, tracker: Tracker, estimator: TravelEstimator
    ) -> list[tuple[int, int]]:
        """Travel at this frame, from the encoder or the load itself, and the matches of tracks and instances."""
        if frame.travel_m is not None:
            self.travel_m, self.estimated = frame.travel_m, False
            estimator.start_at(frame.travel_m)
            return tracker.match(instances, self.travel_m)
        self.travel_m, self.estimated = estimator.step(heights, frame.captured_ns), True
        before_m = estimator.look_back_m()
        if before_m:
            tracker.shift(before_m)
            self.history.shift(before_m)
            self.travel_m = estimator.travel_m
        pairs = tracker.match(instances, self.travel_m)
        residual_m = tracker.residual_m(pairs, instances, self.travel_m)
        self.travel_m = estimator.correct(residual_m or 0.0)
        return pairs

    def _keep_views(
        self, frame: Frame, instances: Instances, found: list[tuple[TrackState, int]], belt: BeltGeometry,
        tracker: Tracker,
    ) -> None:  # fmt: skip
        for track, index in found:
            if track.state is not State.OPEN:
                continue
            offset_m = tracker.past_row_m(track, self.travel_m)
            if track.shelf.wants(offset_m, whole=not bool(instances.cut[index].any())):
                candidate = cut_out(frame, instances, index, belt, offset_m=offset_m)
                if candidate is not None:
                    track.shelf.offer(candidate)

    def _close(self, tracker: Tracker, frame: Frame, *, everything: bool) -> list[ClosedTrack]:
        """Decide the tracks that are due, in the order in which they were opened."""
        closed = []
        for track in tracker.tracks:
            if track.state is not State.OPEN:
                continue
            in_view = tracker.in_view(track, self.travel_m)
            past = tracker.past_row_m(track, self.travel_m) >= self.settings.track.decide_m
            if not (past or everything or not in_view):
                continue
            at = crossing(track, tracker, self.history)
            reason = refusal(track, at, tracker, self.history, self.settings.count, self.travel_m)
            if reason in ("few_frames", "fragment") and in_view and not everything:
                continue
            done = None if reason else self._closed_track(track, at, frame, tracker)
            if isinstance(done, ClosedTrack):
                track.state = State.COUNTED
                self.counted += 1
                closed.append(done)
            else:
                track.state, track.reason = State.DISCARDED, reason or done or "no_view"
                self.discarded[track.reason] += 1
                if track.reason == "distractor":
                    self.rejected.append(at)
            track.shelf.clear()
            track.patch = Patch()
        return closed

    def _closed_track(self, track: TrackState, at: Crossing, frame: Frame, tracker: Tracker) -> ClosedTrack | str:
        """The track as a message with its views; a reason where its views show that it is no tuber."""
        chosen = track.shelf.choose(track.area_mm2)
        if not chosen:
            return "no_view"
        sizes = [size_m(c, tracker.belt) for c in chosen if c.whole] or [size_m(c, tracker.belt) for c in chosen]
        length_m, width_m = (float(np.median(side)) for side in zip(*sizes, strict=True))
        track_id = f"{frame.run}/{frame.camera}/{track.first_seq}-{track.number}"
        usual = [h for h in track.hits if h.whole] or track.hits
        height_mm = float(np.median([h.height_mm for h in usual]))
        in_view = tracker.frames_in_view(track, self.history, self.travel_m)
        refused = shape_refusal(track, width_m=width_m, in_view=in_view, settings=self.settings.count)
        if not refused:
            track.log_odds = self.perception.classify(track.patch)
            refused = class_refusal(track.log_odds, self.settings.count)
        if refused:
            return refused
        message = Track(
            track_id=track_id,
            crossed_ns=at.captured_ns,
            crossed_x_m=at.x_m,
            y_m=at.y_m,
            travel_m=at.travel_m,
            travel_estimated=self.estimated,
            frames=track.frames,
            first_seq=track.first_seq,
            last_seq=track.last_seq,
            length_mm=length_m * 1000,
            width_mm=width_m * 1000,
            height_mm=height_mm,
            visible_volume_ml=float(np.median([h.volume_ml for h in usual])),
            whole=any(h.whole for h in track.hits),
            views_sent=0,
            views=(),
            views_lost={},
        )
        sd_m = self.settings.belt_sd_m
        return ClosedTrack(message, tuple(_view(c, rank, track_id, frame, sd_m) for rank, c in enumerate(chosen)))


def _view(candidate: Candidate, rank: int, track_id: str, frame: Frame, belt_sd_m: float) -> View:
    """A candidate as the message that goes to a regressor."""
    return View(
        view_id=f"{track_id}/{candidate.seq}",
        track_id=track_id,
        camera=frame.camera,
        run=frame.run,
        seq=candidate.seq,
        captured_ns=candidate.captured_ns,
        rank=rank,
        depth_scale_m=frame.depth_scale_m,
        intrinsics=frame.intrinsics,
        u0=candidate.u0,
        v0=candidate.v0,
        depth=candidate.depth,
        belt_from_camera=candidate.belt_from_camera,
        belt_sd_m=belt_sd_m,
    )
