"""Which tracks are due, and whether they count: the count rule, the views, the shape, then the classifier."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, replace
from statistics import median

from conveyor.errors import UnsendableError
from conveyor.messages import Frame, Track, View
from conveyor.messages.base import check_part
from conveyor.messages.views import LATER_PARTS
from conveyor.reasons import TrackRefusal
from conveyor.resting import RestingLevel
from segmenter.classify.patch import Patch
from segmenter.outline.correction import NOTHING_OFF, CameraCorrection
from segmenter.perception import Perception
from segmenter.results import ClosedTrack, Decision, RefusedTrack
from segmenter.track.counting import CountSettings, Crossing, class_refusal, crossing, refusal, shape_refusal
from segmenter.track.follow import BeltFollower
from segmenter.track.foreign import foreign_kind, is_crumb
from segmenter.track.layers import AROUND_M, MOST_OF_TOP, SUPPORT_SD_M, BeltLayers
from segmenter.track.track import State, TrackState
from segmenter.track.tracker import Tracker
from segmenter.track.views import Candidate, size_m

REJECTED_KEPT = 1000
"""Crossings of the newest tracks that the classifier took for distractors; all of them are in `discarded`."""
WAIT_A_TURN = 3
"""For so many tracks that wait one more has its turn: at a steady two a frame each waits for a frame and a half."""
TURNS_NS = 45_000_000
"""Frames that come sooner than this after one another take turns. At 15 a second there is time for all that are due,
and to wait for the next would be the tubers' delay."""
EARLY_FRAMES = 3
"""Seen in fewer frames, a track is too young for its views to be weighed before it is decided."""
MOST_ODDS = 1000.0
MAY_IMPROVE = (TrackRefusal.FEW_FRAMES, TrackRefusal.FRAGMENT)
"""A track refused so is decided later while it is still in view: more frames may show it."""


@dataclass(frozen=True, slots=True)
class Moment:
    """The frame at which tracks are decided, and where everything is. `noise_px`: of the camera's depth, if known;
    `flags`: what is wrong with the camera; `correction`: what of it is corrected."""

    frame: Frame
    tracker: Tracker
    follower: BeltFollower
    noise_px: float | None = None
    flags: tuple[str, ...] = ()
    correction: CameraCorrection = NOTHING_OFF


class TrackDecider:
    """Decides tracks once, and counts them: opened = counted + discarded by reason + open."""

    def __init__(
        self, settings: CountSettings, perception: Perception, *, belt_sd_m: float, resting: RestingLevel
    ) -> None:
        self.counted = 0
        self.discarded: Counter[TrackRefusal] = Counter()
        self.foreign: list[Track] = []
        """Refused since `take_foreign`, in the order in which they were decided."""
        self.foreign_kept = 0
        self.rejected: deque[Crossing] = deque(maxlen=REJECTED_KEPT)
        self._settings = settings
        self._perception = perception
        self._belt_sd_m = belt_sd_m
        self._resting = resting
        self._layers = BeltLayers()
        self._turns = 1
        self._decided_ns = 0

    def decide(self, now: Moment, *, everything: bool) -> list[ClosedTrack]:
        """Decide the tracks that are due, in the order in which they were opened; with `everything` all open ones.

        Where tracks take turns and frames come fast, one is classified a frame, and one more for every three that wait
        since the last.
        """
        closed = []
        since_ns, self._decided_ns = now.frame.captured_ns - self._decided_ns, now.frame.captured_ns
        in_turn = now.tracker.settings.take_turns and since_ns < TURNS_NS and not everything
        waiting = sum(track.waits for track in now.tracker.tracks)
        self._turns = 1 + waiting // WAIT_A_TURN if in_turn else len(now.tracker.tracks)
        for track in now.tracker.tracks:
            if track.state is not State.OPEN:
                continue
            decision = self._decision(track, now, everything=everything)
            if decision is None:
                continue
            self._book(track, decision)
            if isinstance(decision, ClosedTrack):
                closed.append(decision)
        return closed

    def early(self, now: Moment) -> list[View]:
        """Views of open tracks past the row that will hardly change any more, each once: they may be weighed already.

        Whether a track counts, and by which views, is decided later and without regard to this.
        """
        views: list[View] = []
        for track in now.tracker.tracks:
            past_m = now.tracker.past_row_m(track, now.follower.travel_m)
            if track.state is not State.OPEN or not track.countable or past_m < 0 or track.frames < EARLY_FRAMES:
                continue
            for slot, candidate in track.shelf.settled(track.area_m2, past_m=past_m):
                if slot not in track.sent_early:
                    track.sent_early.add(slot)
                    views.append(self._view(candidate, slot, _track_id(track, now), now))
        return views

    def _view(self, candidate: Candidate, rank: int, track_id: str, now: Moment, *, high_m: float = 0.0) -> View:
        """The view of a tuber; where its underside lies `high_m` above the belt, on others, it has an id of its own:
        it may have been weighed early as one on the belt."""
        level = _level(self._resting, min(high_m, MOST_OF_TOP * candidate.height_m))
        view = _view(candidate, rank, track_id, now, self._belt_sd_m).resting_on(level)
        return replace(view, view_id=f"{view.view_id}-on-others") if high_m > 0 else view

    def take_foreign(self) -> tuple[Track, ...]:
        """What was refused as a clod, a stone or haulm since the last call."""
        taken, self.foreign = tuple(self.foreign), []
        return taken

    def _decision(self, track: TrackState, now: Moment, *, everything: bool) -> Decision | None:
        """What becomes of a track; None where it is not due, or waits for its turn."""
        track.waits = False
        tracker, travel_m = now.tracker, now.follower.travel_m
        in_view = tracker.in_view(track, travel_m)
        past = tracker.past_row_m(track, travel_m) >= tracker.settings.decide_m
        if not (past or everything or not in_view):
            return None
        at = crossing(track, tracker, now.follower.history)
        reason = refusal(track, at, tracker, now.follower.history, self._settings, travel_m)
        if reason in MAY_IMPROVE and in_view and not everything:
            return None
        if reason is not None:
            return RefusedTrack(reason)
        track.waits = self._turns <= 0 and in_view
        if track.waits:
            return None
        decision = self._measured(track, at, now)
        if isinstance(decision, RefusedTrack) and decision.reason is TrackRefusal.DISTRACTOR:
            self.rejected.append(at)
        return decision

    def _measured(self, track: TrackState, at: Crossing, now: Moment) -> Decision:
        """The track with its views, or why its views show that it is no tuber."""
        chosen = track.shelf.choose(track.area_m2)
        if not chosen:
            return RefusedTrack(TrackRefusal.NO_VIEW)
        length_m, width_m = _sides_m(chosen, now.tracker)
        in_view = now.tracker.frames_in_view(track, now.follower.history, now.follower.travel_m)
        reason = shape_refusal(track, width_m=width_m, in_view=in_view, settings=self._settings)
        if reason is None:
            # Asked last and once: each answer also teaches the classifier's prior what this belt carries.
            track.answer = self._perception.classify(track.patch, limit=self._settings.reject_below)
            self._turns -= self._perception.classifies
            reason = class_refusal(track.answer, self._settings)
        kind = foreign_kind(reason, length_m=length_m, width_m=width_m)
        if reason is not None and kind is None:
            return RefusedTrack(reason)
        track_id = _track_id(track, now)
        high_m = self._layers.support_m(track.rims, _around(track, now.tracker))
        views = tuple(
            self._view(candidate, rank, track_id, now, high_m=high_m) for rank, candidate in enumerate(chosen)
        )
        under_m = median(view.resting_offset_m for view in views)
        message = _message(
            track, at, now, track_id=track_id, length_m=length_m, width_m=width_m, under_m=under_m, high_m=high_m
        )
        if kind is not None or track.answer is not None:
            log_odds = None if track.answer is None else min(max(track.answer.log_odds, -MOST_ODDS), MOST_ODDS)
            message = replace(message, kind=kind or "tuber", log_odds=log_odds)
        try:
            check_part(message)
        except UnsendableError:
            return RefusedTrack(reason or TrackRefusal.OUT_OF_RANGE)  # a mat of haulm may be longer than any tuber
        if reason is not None:
            crumb = is_crumb(message, least_ml=self._settings.min_volume_m3 * 1e6)
            return RefusedTrack(reason, None if crumb else message)
        return ClosedTrack(message, views, track.answer)

    def _book(self, track: TrackState, decision: Decision) -> None:
        if isinstance(decision, RefusedTrack):
            track.state, track.reason = State.DISCARDED, decision.reason
            self.discarded[decision.reason] += 1
            if decision.foreign is not None:
                self.foreign.append(decision.foreign)
                self.foreign_kept += 1
        else:
            track.state = State.COUNTED
            self.counted += 1
            if (said := track.said_by_rims()) is not None:
                self._layers.learn(said)
        track.shelf.clear()
        track.patch = Patch()


def _track_id(track: TrackState, now: Moment) -> str:
    return track.track_id(now.frame.run, now.frame.camera)


def _around(track: TrackState, tracker: Tracker) -> list[float]:
    """Evidence of lying on others of the tracks around one along the belt."""
    near = [t for t in tracker.tracks if t is not track and abs(t.place_x_m - track.place_x_m) <= AROUND_M]
    said = [t.said_by_rims() for t in near if t.state is not State.DISCARDED]
    return [one for one in said if one is not None]


def _level(resting: RestingLevel, high_m: float) -> RestingLevel:
    """Where the underside of a tuber is: at the line's resting level, or on those that it lies on."""
    return resting if high_m == 0 else RestingLevel(offset_m=-high_m, sd_m=SUPPORT_SD_M)


def _sides_m(chosen: list[Candidate], tracker: Tracker) -> tuple[float, float]:
    """(length, width): medians over the views that no border cuts, or over all."""
    sizes = [size_m(c, tracker.belt) for c in chosen if c.whole] or [size_m(c, tracker.belt) for c in chosen]
    length_m, width_m = (median(side) for side in zip(*sizes, strict=True))
    return length_m, width_m


def _message(
    track: TrackState,
    at: Crossing,
    now: Moment,
    *,
    track_id: str,
    length_m: float,
    width_m: float,
    under_m: float,
    high_m: float,
) -> Track:
    """The track as it is logged, in the message's millimetres and millilitres.

    `under_m`: how far its underside lies below the belt plane that heights and volumes are measured from. `high_m`: how
    high it lies on others.
    """
    usual = [hit for hit in track.hits if hit.whole] or track.hits
    true = now.correction.true_per_seen
    under_m3 = under_m * track.area_m2 * true**2
    return Track(
        track_id=track_id,
        crossed_ns=at.captured_ns,
        crossed_x_m=at.x_m,
        y_m=at.y_m,
        travel_m=at.travel_m,
        travel_estimated=now.follower.estimated,
        frames=track.frames,
        first_seq=track.first_seq,
        last_seq=track.last_seq,
        length_mm=length_m * true * 1e3,
        width_mm=width_m * true * 1e3,
        height_mm=max(0.0, median(hit.height_m for hit in usual) * true**2 + under_m) * 1e3,
        visible_volume_ml=max(0.0, median(hit.volume_m3 for hit in usual) * true**4 + under_m3) * 1e6,
        whole=any(hit.whole for hit in track.hits),
        views_sent=0,
        views=(),
        views_lost={},
        support_mm=high_m * 1e3,
        flags=now.flags,
    )


def _view(candidate: Candidate, rank: int, track_id: str, now: Moment, belt_sd_m: float) -> View:
    """A candidate as the message that goes to a regressor."""
    frame = now.frame
    view = View(
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
        camera_noise_px=now.noise_px,
        takes=LATER_PARTS,
    )
    return now.correction.corrected(view)
