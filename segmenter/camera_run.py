"""One camera in one run: frames in, views out, weights in, log entries out. Everything but sockets and clocks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from conveyor.messages import CameraInfo, Frame, FrameProgress, Mark, Picture, Track, Travel, View, Weight
from conveyor.messages.tracks import CARRIED, UNFOLLOWED
from conveyor.processors import Busy
from conveyor.reasons import FrameDrop, ViewLoss
from segmenter.balance import FrameBalance
from segmenter.dispatch.dispatcher import Dispatcher, DispatchSettings
from segmenter.dispatch.early import EarlyViews
from segmenter.dispatch.refusal_words import RefusalWords
from segmenter.dispatch.thinning import Thinning
from segmenter.dispatch.view_budget import ViewBudget
from segmenter.dispatch.weighing import Weighing
from segmenter.known import Known
from segmenter.pipeline import Segmenter, Settings
from segmenter.provisional import ProvisionalWeights
from segmenter.results import ClosedTrack, StepResult
from segmenter.resume import resume_after
from segmenter.sheets import added, as_logged, but_zeros, lost_share, tracks_left, views_left
from segmenter.tracklog import TrackLog
from segmenter.view_for_people import picture_of

MARK_EVERY_M = 0.5
MARK_EVERY_NS = 1_000_000_000
LIVE_MARK_EVERY_NS = 60_000_000
"""A tuber is committed with the next mark of every camera: in a replay that costs nothing, live it is the latency. So
every frame at 15 a second, every second one at 30; 0.5 kB each."""
MARK_TURN_M = 0.004
"""Estimated travel is told to the other cameras by the marks alone: between two of them it is taken for a line."""
EMPTY_S = 2.0
MOST_BEHIND = 4096
"""Entries of a live camera's log that a living aggregator may be behind, 90 s of a full belt: one that was frozen or
started again costs no frame. Beyond, it does not keep up, and frames are left out until it does. One that is away costs
no frame before the log is nearly full."""


@dataclass(frozen=True, slots=True)
class RunSettings:
    """Settings of a camera's run."""

    core: Settings
    dispatch: DispatchSettings
    weigh_deadline_s: float
    max_pending_views: int
    window: int
    mark_every_ns: int = MARK_EVERY_NS
    spare_grace_s: float | None = None
    """A weighed tuber waits this long for its other views; None: until they are answered or lost."""
    fewer_views: bool = False
    """Weigh fewer views of each tuber while the regressors are busy all the time."""
    free_share: float = 0.0
    """Of the machine's processors, what second and later views leave free."""
    log_behind: bool = False
    """A thread of its own writes the log."""
    replays: bool = False
    """The camera goes back to its first frame for a segmenter that starts again."""


class CameraRun:
    """Owns the core, the dispatcher, the tracks that wait and the log. Times are seconds of any steady clock."""

    def __init__(
        self, camera: str, run: str, settings: RunSettings, log_path: Path | None, *, known: Known | None = None
    ) -> None:
        """`known`: what is known of the camera already."""
        self.camera = camera
        self.run = run
        self.settings = settings
        self.log = TrackLog(log_path, camera=camera, run=run, behind=settings.log_behind)
        self.frames = FrameBalance()
        self.dispatcher = Dispatcher(settings.dispatch)
        self.weighing = Weighing(settings.weigh_deadline_s, spare_grace_s=settings.spare_grace_s)
        self.budget = ViewBudget(settings.core.views_per_tuber, settings.free_share)
        self._known = known
        self.core = Segmenter(settings.core, known=known)
        self.early = EarlyViews()
        self.provisional = ProvisionalWeights()
        self._thinning = Thinning()
        self._refusals = RefusalWords()
        self.ended = False
        self.aggregator_lives = False
        self._done_seq = -1
        self._marked: tuple[int, float] | None = None
        self._marked_speed = 0.0
        self._newest_ns = 0
        self._now_s = 0.0
        self._heard_s: float | None = None
        self._base_views: dict[str, int] = {}
        self._base_tracks: dict[str, int] = {}
        self._lost_share = 0.0

    def open(self) -> None:
        """Open the log; where it holds a mark, carry on from there.

        A replay does not carry on but starts again, unless its log is complete: then every track comes out as it would
        have without the restart, and those logged before are repeats that change nothing.
        """
        self.log.__enter__()
        mark = self.log.last_mark
        if mark is None or (self.settings.replays and not mark.final):
            return
        self.ended = mark.final
        resume = resume_after(mark, self.log.since_mark, self.log.speed_mps)
        self.core = Segmenter(self.settings.core, resume=resume, known=self._known)
        self.frames.resume(mark.frames, mark.frames.get("first_seq", 0))
        self._base_views = views_left(mark.views, self.log.since_mark)
        self._refusals.know(self._base_views)
        self._base_tracks = tracks_left(mark.tracks, self.log.since_mark)
        self._lost_share = lost_share(mark.tracks, self._base_tracks)
        self._done_seq = self.frames.newest_seq

    def close(self) -> None:
        """Close the log's file."""
        self.log.__exit__(None, None, None)

    def frame(self, frame: Frame, now_s: float, *, drop: FrameDrop | None = None) -> StepResult | None:
        """Take a frame; None where it is a duplicate, or the one before it is still to come.

        `drop`: count it as dropped for this reason instead.
        """
        self._heard_s = now_s
        if self.ended or not self.frames.receive(frame.seq, after_seq=frame.after_seq):
            return None
        if drop is None and self._far_behind:
            drop = FrameDrop.BEHIND
        if drop is None and self._spared(frame):
            drop = FrameDrop.OVERLOAD
        if drop is not None:
            self.frames.dropped[drop] += 1
            return None
        result = self.core.step(frame)
        if result.dropped is not None:
            self.frames.dropped[result.dropped] += 1
        else:
            self.frames.processed += 1
            self._newest_ns = max(self._newest_ns, frame.captured_ns)
            self._thinning.looked(frame.captured_ns, self.core.travel_m)
        self._take(list(result.closed), now_s)
        self._take_early(result.early, now_s)
        self._keep(result.foreign, now_s)
        return result

    @property
    def _far_behind(self) -> bool:
        """The aggregator lives, and takes less than this camera logs; or it was away until the log was nearly full."""
        if self.settings.replays:
            return False
        return self.log.nearly_full or (self.aggregator_lives and self.log.uncommitted > MOST_BEHIND)

    def _spared(self, frame: Frame) -> bool:
        """So many tubers wait for their first view that this frame is left out."""
        return self.dispatcher.pressed and self._thinning.spares(frame.captured_ns)

    def info(self, info: CameraInfo, now_s: float) -> None:
        """Take what the camera says of itself; ends the run when it ended and everything it sent is here or lost."""
        if self.ended:
            return
        if self._heard_s is None:
            self._heard_s = now_s
        self.frames.known_range(info.first_seq, info.last_seq)
        here = info.last_seq is not None and self.frames.newest_seq >= info.last_seq
        silent = now_s - self._heard_s >= EMPTY_S
        # A camera that waits sends a frame again until it is done: silence means a bad link or a process that was
        # stopped for a while, never a frame to give up. Only what its source refused will not come.
        missing = 0 if info.last_seq is None else info.last_seq - self.frames.newest_seq
        sure = not info.waits or info.state == "failed" or missing <= sum(info.refused.values())
        if info.state == "failed" and info.live:
            return  # a device comes back: what passes meanwhile is a gap in its run, not the end of it
        if info.state in ("ended", "failed") and ((silent and sure) or (here and info.state == "ended")):
            self.end(now_s)

    def end(self, now_s: float) -> None:
        """Nothing more comes: decide what is still open. The final mark follows when all views are answered."""
        if not self.ended:
            self.ended = True
            self._take(self.core.finish(), now_s)
            self._keep(self.core.take_foreign(), now_s)
            for view_id in self.early.rest():
                self.dispatcher.give_up(view_id, ViewLoss.NOT_CHOSEN)

    def weight(self, weight: Weight) -> None:
        """Take a regressor's answer."""
        usable = weight.status == "weighed" and None not in (weight.weight_g, weight.low_g, weight.high_g)
        reason = self._refusals.word(weight.reason)
        known = self.dispatcher.answer(weight.view_id, regressor=weight.regressor, usable=usable, reason=reason)
        if known and usable:
            self.provisional.add(weight)
        if known and usable and not self.early.answered(weight):
            self.weighing.weighed(weight, self._now_s)

    def tick(self, now_s: float, regressors: set[str], *, machine: Busy | None = None) -> list[tuple[str, View]]:
        """Move everything on; returns the views to send, each with its regressor. `machine`: how busy this one is."""
        self._now_s = now_s
        self.dispatcher.present(regressors)
        self.dispatcher.expire(now_s)
        if self.settings.fewer_views:
            busy, of = self.dispatcher.busy
            self.budget.step(now_s, busy=busy, of=of, machine=machine)
        for track_id in self.weighing.overdue(now_s):
            self.dispatcher.cancel(track_id, ViewLoss.WEIGH_DEADLINE)
        for track_id in self.weighing.weighed_enough(now_s):
            self.dispatcher.cancel(track_id, ViewLoss.LATE)
        for loss in self.dispatcher.take_losses():
            if not self.early.lost(loss):
                self.weighing.lost(loss)
        self.early.forget_old(now_s)
        items: list[Track | Mark] = list(self.weighing.take_done())
        mark = self._mark_due()
        if mark is not None:
            items.append(mark)
        if items:
            self.log.append(items)
        return self.dispatcher.assign(now_s)

    def progress(self) -> FrameProgress:
        """How far the camera may go on. Held back while too many views wait for a regressor, or entries of the log for
        the aggregator."""
        if self.dispatcher.outstanding <= self.settings.max_pending_views and not self.log.nearly_full:
            self._done_seq = max(self._done_seq, self.frames.newest_seq)
        return FrameProgress(camera=self.camera, run=self.run, done_seq=self._done_seq, window=self.settings.window)

    def travel(self, captured_ns: int) -> Travel:
        """Where the belt is."""
        return Travel(
            source=self.camera,
            run=self.run,
            captured_ns=captured_ns,
            travel_m=self.core.travel_m,
            estimated=self.core.estimated,
        )

    def picture(self, frame: Frame, result: StepResult) -> Picture | None:
        """What `frame`, the newest one, shows to people; None where it cannot be made small enough."""
        used = result.dropped is None
        return picture_of(
            frame,
            belt=self.core.belt,
            instances=self.core.instances if used else None,
            found=self.core.found,
            weights=self.provisional,
            drop=result.dropped or "",
        )

    def counts(self) -> dict[str, dict[str, int]]:
        """The balance sheets: frames, views, tracks. A track counts once it is in the log; until then it is open."""
        tracks, waiting, foreign = self.core.track_counts(), self.weighing.tubers, self.weighing.foreign
        logged = {**tracks, "counted": tracks["counted"] - waiting, "open": tracks["open"] + waiting}
        if foreign:
            logged["foreign"] = tracks["foreign"] - foreign
        unseen = {UNFOLLOWED: self.core.unfollowed_ms, CARRIED: self.core.carried_ms}
        return {
            "frames": {**self.frames.report(), "first_seq": self.frames.first_seq or 0, **but_zeros(unseen)},
            "views": added(self.dispatcher.balance(), self._base_views),
            "tracks": added(logged, self._base_tracks),
        }

    def _take(self, closed: list[ClosedTrack], now_s: float) -> None:
        for loss in self.dispatcher.take_losses() if closed else ():
            if not self.early.lost(loss):
                self.weighing.lost(loss)
        wanted = self._views_wanted() if closed else 0
        in_time = self.weighing.waits_for(self.dispatcher.in_flight.usual_s)
        for track in closed:
            early = self.early.closed(track.track.track_id)
            self.weighing.add(track, now_s)
            weighed = any(view.view_id in early.answers for view in track.views)
            for n, view in enumerate(track.views):
                if (answer := early.answers.get(view.view_id)) is not None:
                    self.weighing.weighed(answer, now_s)
                elif (lost := early.losses.get(view.view_id)) is not None:
                    self.weighing.lost(lost)
                else:
                    spare = n >= wanted or (weighed and not in_time)
                    self.dispatcher.offer(view, now_s=now_s, spare=spare, weighed=weighed)
            for view_id in sorted(early.sent - {view.view_id for view in track.views}):
                self.dispatcher.give_up(view_id, ViewLoss.NOT_CHOSEN)

    def _take_early(self, views: tuple[View, ...], now_s: float) -> None:
        wanted = self._views_wanted() if views else 0
        for view in views:
            if view.rank < wanted:
                self.early.sent(view, now_s)
                self.dispatcher.offer(view, now_s=now_s)

    def _views_wanted(self) -> int:
        """How many views of a tuber are weighed, as things stand."""
        return self.budget.now(self.dispatcher.backlog_s) if self.settings.fewer_views else self.budget.most

    def _keep(self, foreign: Sequence[Track], now_s: float) -> None:
        """Log what is no tuber as what it is; no one weighs it."""
        for track in foreign:
            self.weighing.add(ClosedTrack(track, ()), now_s)

    def _mark_due(self) -> Mark | None:
        if self.log.last_mark is not None and self.log.last_mark.final:
            return None
        if self.ended:
            return self._mark(final=True) if len(self.weighing) == 0 else self._mark_after_the_end()
        if self.frames.processed == 0 or self._newest_ns == 0 or self._repeats:
            return None
        if self._marked is not None:
            waited_ns, moved_m = self._newest_ns - self._marked[0], abs(self.core.travel_m - self._marked[1])
            if waited_ns < self.settings.mark_every_ns and moved_m < MARK_EVERY_M and not self._belt_turned():
                return None
            self._marked_speed = (self.core.travel_m - self._marked[1]) / max(waited_ns, 1)
        self._marked = (self._newest_ns, self.core.travel_m)
        return self._mark(final=False)

    @property
    def _repeats(self) -> bool:
        """A replay that started again is not yet where its log ends: what was looked at before stays looked at."""
        before = self.log.last_mark
        return self.settings.replays and before is not None and self._newest_ns <= before.captured_ns

    def _mark_after_the_end(self) -> Mark | None:
        """Views are still weighed: a mark where that let as much belt become certain as there is between two marks."""
        before, mark = self.log.last_mark, self._mark(final=False)
        if before is None or mark.complete_ns - before.complete_ns >= self.settings.mark_every_ns:
            return mark
        return mark if before.complete_place_x_m - mark.complete_place_x_m >= MARK_EVERY_M else None

    def _belt_turned(self) -> bool:
        """The belt, its travel estimated, no longer runs as it did between the last two marks."""
        if self._marked is None or not self.core.estimated:
            return False
        expected_m = self._marked[1] + self._marked_speed * (self._newest_ns - self._marked[0])
        return abs(self.core.travel_m - expected_m) > MARK_TURN_M

    def _mark(self, *, final: bool) -> Mark:
        complete_m = self.core.travel_m if final else self.core.complete_travel_m()
        complete_ns = self._newest_ns if final else self.core.complete_ns(complete_m)
        waiting = self.weighing.earliest()
        if waiting is not None:
            complete_ns = min(complete_ns, waiting[0] - 1)
            complete_m = min(complete_m, math.nextafter(waiting[1], -math.inf))
        before = self.log.last_mark
        captured_ns, estimated, looked_at_m = self._newest_ns, self.core.estimated, self.core.looked_at_m
        if before is not None and not captured_ns:  # started again after the camera had ended: it saw no frame
            captured_ns, estimated = before.captured_ns, before.travel_estimated
            looked_at_m *= 1.0 - self._lost_share
        place_m = self.core.row_place_m(complete_m)
        if before is not None:
            complete_ns, place_m = max(complete_ns, before.complete_ns), min(place_m, before.complete_place_x_m)
        counts = self.counts()
        return Mark(
            captured_ns=captured_ns,
            travel_m=self.core.travel_m,
            travel_estimated=estimated,
            complete_ns=complete_ns,
            complete_place_x_m=place_m + 0.0,  # never -0.0, which SQLite gives back as 0.0
            final=final,
            looked_at_m=looked_at_m,
            travelled_m=self.core.travelled_m,
            frames=counts["frames"],
            views=as_logged(counts["views"], self.weighing.settled + self.early.settled),
            tracks=counts["tracks"],
        )
