"""The camera's process: frames of one source onto the line, at their pace and, for a replay, without losing any."""

from __future__ import annotations

import math
import time
from collections import Counter
from dataclasses import replace
from typing import Literal

from camera_sim.flow import Pace, SendWindow
from camera_sim.outlet import FrameOutlet
from camera_sim.stamped import FrameStamper
from conveyor import topics
from conveyor.camera_clock import CameraClock
from conveyor.config import LineConfig
from conveyor.config_camera import CameraConfig
from conveyor.delivery import KeptPublisher, KeptSubscriber
from conveyor.errors import TuberlineError
from conveyor.formats import PolledSource, Refused, Source
from conveyor.formats.inspection import described_doubtfully
from conveyor.formats.source import within_ranges
from conveyor.messages import CameraInfo, Frame, FrameProgress
from conveyor.node import Node

INFO_EVERY_S = 0.5
STALL_AFTER_S = 10.0
POLL_S = 0.05
NUMBERING_S = 1.0
"""A camera that waits for no one asks this long how far the run got, so that a restarted one numbers on from there;
where the answer comes later, it goes on from there then."""


class CameraNode:
    """The shell: sockets and clocks around a source.

    With `waits` it starts when a segmenter is there, keeps at most `window` frames in flight, sends them again when
    nothing moves, and never gives up. Each frame says which one was sent before it, so that the segmenter can tell what
    the link lost from what the recording lacks. Without it no one is waited for.
    """

    def __init__(self, config: LineConfig, camera: str, run: str, source: Source) -> None:
        self._config = config
        self._settings: CameraConfig = config.camera(camera)
        self._source = source
        self._waits = self._settings.waits and not source.description.live
        self._node = Node("camera", camera, config=config, run=run)
        self._window = SendWindow(self._settings.window)
        speed = 1.0 if source.description.live else self._settings.speed
        self._pace = Pace(0.0 if source.description.live else speed)
        self._clock = CameraClock(speed)
        self._refused: Counter[str] = Counter()
        self._first: int | None = None
        self._last: int | None = None
        self._oldest: tuple[int, float | None] | None = None
        self._newest: tuple[int, float | None] | None = None
        self._published = 0
        self._info_s = -INFO_EVERY_S
        self._stalled = False
        self._silent = False
        self._done_seq = -1
        self._word = False
        self._back_to: int | None = None
        self._numbered_from = 0
        self._stamper: FrameStamper | None = None
        self._begins = True

    def run(self) -> None:
        """Publish everything, say that it ended, stay until stopped."""
        with self._node as node, FrameOutlet(node, self._config, codec=self._settings.compress) as self._frames:
            self._infos = KeptPublisher(node, topics.CAMERA_INFO, camera=node.name)
            self._progress = KeptSubscriber(node, topics.FRAME_PROGRESS, FrameProgress, camera=node.name)
            for counter in ("frames_published", "frames_resent", "frames_refused", "segmenter_stalls", "went_back"):
                node.counters.add(counter, 0)
            if self._source.description.live:
                node.counters.add("frames_missed", 0)
                if self._config.encoder is not None and self._settings.of_today:
                    self._stamper = FrameStamper(node, self._config.encoder)
            if isinstance(self._source, PolledSource):
                self._source.attach(self._while_silent)
            for note in described_doubtfully(self._source.description):
                node.log.warning("%s: %s", self._source.description.origin, note)
            self._tell("starting")
            try:
                self._publish_all()
            except TuberlineError as error:
                self._tell("failed", error=str(error))
                raise

    def _publish_all(self) -> None:
        """Publish everything, say that it ended, stay until stopped; go back where the segmenter has to start again.

        Only a source that has no more frames ends a camera's run. A process that is told to stop says nothing: what
        passes until the next one starts is a gap in the run, and the aggregator knows when the whole line was stopped.
        """
        after = self._done_before()
        if after >= 0:
            self._note(after)  # it was there: a segmenter that starts again must not take "ended" for "empty"
        while not self._node.stop.is_set():
            self._publish_after(after)
            if self._node.stop.is_set():
                return  # stopped, not ended: by a reboot or its unit's restart; the run goes on when it starts again
            if self._back_to is None:
                self._tell("ended")
                self._node.log.info("ended after frame %s: %d published", self._last, self._published)
                self._stay()
            if self._back_to is not None:
                after, self._back_to = self._back_to, None
                self._go_back(after)

    def _publish_after(self, after: int) -> None:
        """All frames above `after`, until none is in flight any more or the segmenter starts again."""
        for found in self._source.frames(run=self._node.run, after=after):
            item = within_ranges(self._numbered_on(found))
            if isinstance(item, Refused):
                self._refuse(item)
            else:
                self._wait_for_turn(item)
                if self._interrupted:
                    return
                stamped = self._stamped(item)
                if stamped is None:
                    continue
                self._publish(replace(stamped, after_seq=after) if self._waits else self._on_time(stamped))
                after = item.seq
        while self._waits and self._window.in_flight and not self._interrupted:
            self._wait_for_progress()

    def _numbered_on(self, item: Frame | Refused) -> Frame | Refused:
        """What a live source gives, numbered above all that the run had before this process.

        A segmenter that starts with its camera, after a reboot say, tells how far the run got only when it is ready,
        and takes what has an old number for an old frame.
        """
        if self._waits or not self._source.description.live:
            return item
        seq = item.seq + self._numbered_from
        done = max((p.done_seq for p in self._progress.latest().values() if p.run == self._node.run), default=-1)
        if done >= seq:
            self._node.log.warning("the run had frames up to %d already: numbering on from there", done)
            self._node.counters.add("numbered_on")
            self._numbered_from += done + 1 - seq
            self._note(done)
        return replace(item, seq=item.seq + self._numbered_from)

    @property
    def _interrupted(self) -> bool:
        return self._node.stop.is_set() or self._back_to is not None

    def _stay(self) -> None:
        """Late joiners get the info while this process lives; a segmenter that starts again gets the frames again."""
        while not self._interrupted:
            if self._waits:
                self._wait_for_progress()
            else:
                self._node.stop.wait(0.5)
                self._node.progress()

    def _go_back(self, after: int) -> None:
        self._window = SendWindow(self._settings.window)
        self._pace = Pace(self._settings.speed)
        self._done_seq = after
        self._node.counters.add("went_back")
        self._node.log.warning("the segmenter started again: going back to frame %d", after + 1)

    def _done_before(self) -> int:
        """The newest frame the segmenter has done in this run already, where this process was restarted; else -1.

        With `waits` a segmenter that listens is waited for; without, only long enough to learn where to number on.
        """
        give_up_s = time.monotonic() + (math.inf if self._waits else NUMBERING_S)
        while time.monotonic() < give_up_s and not self._node.stop.is_set():
            if self._frames.has_segmenter:
                for progress in self._progress.latest().values():
                    self._done_seq = progress.done_seq if progress.run == self._node.run else -1
                    return self._done_seq
            self._progress.wait(POLL_S)
            self._node.progress()
        return -1

    def _wait_for_turn(self, frame: Frame) -> None:
        due_s = self._pace.due_s(frame.captured_ns, time.monotonic())
        while not self._interrupted:
            left_s = due_s - time.monotonic()
            if left_s > 0:
                self._node.stop.wait(min(left_s, POLL_S))
                self._node.progress()
            elif self._waits and not self._window.has_room:
                self._wait_for_progress()
            else:
                return

    def _wait_for_progress(self) -> None:
        """Wait a little for the segmenter's word, take it, and send again what seems lost."""
        self._word |= self._progress.wait(POLL_S)
        now_s = time.monotonic()
        for progress in self._progress.latest().values():
            if progress.run == self._node.run:
                if progress.done_seq < self._done_seq:
                    self._back_to = progress.done_seq
                    return
                self._done_seq = progress.done_seq
                self._window.done(progress.done_seq, now_s)
        # Only on a segmenter's word: one that starts again would take a frame from the middle for its first.
        for frame in self._window.to_resend(now_s) if self._word else ():
            self._word = False
            self._frames.put(frame)
            self._node.counters.add("frames_resent")
        self._watch_stall(now_s)
        self._node.progress()

    def _watch_stall(self, now_s: float) -> None:
        still_s = self._window.still_s(now_s)
        self._node.counters.gauge("waiting_for_segmenter_s", still_s)
        if (still_s >= STALL_AFTER_S) != self._stalled:
            self._stalled = not self._stalled
            if self._stalled:
                self._node.counters.add("segmenter_stalls")
                self._node.log.warning("no progress from the segmenter for %.0f s; frames wait, none is lost", still_s)

    def _while_silent(self, silent_s: float) -> bool:
        """A live source's process looks round while nothing comes; False: stop."""
        self._node.progress()
        if self._stamper is not None:
            self._stamper.listen()
        reopened = getattr(self._source, "reopened", None)
        if reopened is not None:
            self._node.counters.gauge("source_reopened", reopened)
        self._node.counters.gauge("source_silent_s", round(silent_s, 1) if silent_s >= 1.0 else 0.0)
        if (silent_s >= STALL_AFTER_S) != self._silent:
            self._silent = not self._silent
            if self._silent:
                self._node.counters.add("source_stalls")
                self._node.log.warning("nothing from %s for %.0f s", self._source.description.origin, silent_s)
        if time.monotonic() - self._info_s >= INFO_EVERY_S and self._last is not None:
            self._tell("streaming")
        return not self._node.stop.is_set()

    def _stamped(self, frame: Frame) -> Frame | None:
        """The frame with the travel that the line's encoder tells; None where it is held back, for the run begins and
        nothing was told yet. One that is gone on with takes what comes.
        """
        if self._stamper is None:
            return frame
        if self._begins:
            done = [p.done_seq for p in self._progress.latest().values() if p.run == self._node.run]
            if max(done, default=-1) < 0:
                first = self._stamper.first(frame, segmenter=bool(done))
                self._begins = first is None
                return first
            self._begins = False
        return self._stamper.stamped(frame)

    def _on_time(self, frame: Frame) -> Frame:
        """The frame of a camera that waits for no one, without the steps of its clock: frames and what is said of them
        then have one time, as long as this process lives.
        """
        steady_ns, step_ns = self._clock.steady_ns(frame.seq, frame.captured_ns, time.monotonic_ns())
        if step_ns:
            self._node.counters.add("clock_steps")
            self._node.counters.gauge("clock_offset_s", self._clock.offset_ns / 1e9)
            self._node.log.warning(
                "the camera's clock stepped by %+.3f s before frame %d: times go on as if it had not",
                step_ns / 1e9, frame.seq,
            )  # fmt: skip
        return frame if steady_ns == frame.captured_ns else replace(frame, captured_ns=steady_ns)

    def _publish(self, frame: Frame) -> None:
        self._frames.put(frame)
        self._word = False
        now_s = time.monotonic()
        if self._waits:
            self._window.sent(frame, now_s)
        if self._last is None or frame.seq > self._last:
            if self._source.description.live and self._last is not None:
                self._node.counters.add("frames_missed", frame.seq - self._last - 1)
            self._published += 1
            self._newest = (frame.captured_ns, frame.travel_m)
            self._oldest = self._oldest or self._newest
            self._node.counters.add("frames_published")
        else:
            self._node.counters.add("frames_resent")
        self._note(frame.seq)
        self._node.progress()
        if now_s - self._info_s >= INFO_EVERY_S:
            self._tell("streaming")

    def _refuse(self, refused: Refused) -> None:
        if self._last is not None and refused.seq <= self._last:
            return
        self._note(refused.seq)
        self._node.log.error("refused %s", refused.text)
        self._refused[refused.reason] += 1
        self._node.counters.add("frames_refused")
        self._node.counters.add(f"frames_refused_{refused.reason}")

    def _note(self, seq: int) -> None:
        self._first = seq if self._first is None else min(self._first, seq)
        self._last = seq if self._last is None else max(self._last, seq)

    def _tell(self, state: Literal["starting", "streaming", "ended", "failed"], *, error: str = "") -> None:
        self._info_s = time.monotonic()
        d = self._source.description
        oldest, newest = self._oldest or (None, None), self._newest or (None, None)
        self._infos.put(
            CameraInfo(
                camera=self._node.name,
                run=self._node.run,
                state=state,
                source=d.origin,
                fps=d.fps,
                waits=self._waits,
                intrinsics=d.intrinsics,
                depth_scale_m=d.depth_scale_m,
                first_seq=self._first,
                last_seq=self._last,
                published=self._published,
                refused=dict(self._refused),
                error=error[:4000],
                first_captured_ns=oldest[0],
                first_travel_m=oldest[1],
                last_captured_ns=newest[0],
                last_travel_m=newest[1],
                live=d.live,
                serial=d.serial,
            )
        )


def run_camera(config: LineConfig, camera: str, run: str) -> None:
    """The `camera` command's work: open the configured source and publish it."""
    from camera_sim.configured import configured_source

    CameraNode(config, camera, run, configured_source(config, camera)).run()
